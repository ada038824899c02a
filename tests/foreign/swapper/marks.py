"""What was used leaves a mark."""

USED: set[str] = set()


def mark(part: object) -> None:
    """Note the class that is at work."""
    USED.add(part if isinstance(part, str) else type(part).__name__)
