"""Social navigation, the domain that proves the library: world, environment, demonstrators, audit and metrics."""
