"""Parts are built from a config with live objects, and nothing that a config names is ignored."""

# ruff: noqa: E501  (tables)

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Literal, Protocol

import pytest
import torch
from omegaconf import OmegaConf
from torch import nn

from morlnav.annotations import describe, fits
from morlnav.config import Part, as_part, build, check, plain, setting, supply, takes


class Wheel:
    def __init__(self, radius: float = 0.1, name: str | None = None) -> None:
        if radius <= 0:
            raise ValueError(f"radius must be positive, got {radius}.")
        self.radius, self.name = radius, name


class Cart:
    def __init__(
        self,
        wheels: Sequence[Wheel],
        lights: Mapping[str, Wheel | None] | None = None,
        kind: Literal["small", "large"] = "small",
        limits: tuple[float, float] = (0.0, 1.0),
        *,
        seats: int,
    ) -> None:
        self.wheels, self.lights, self.kind, self.limits, self.seats = wheels, lights, kind, limits, seats


class Truck(Cart):
    """Passes on what it does not know."""

    def __init__(self, *args, load: float = 1.0, **settings) -> None:
        super().__init__(*args, **settings)
        self.load = load


class Garage:
    def __init__(self, car: Part[Cart], others: Mapping[str, Part[Cart] | None], wheel: Wheel | None = None) -> None:
        self.car, self.others, self.wheel = car, others, wheel


class Horn(Protocol):
    def __call__(self, seconds: float) -> str: ...


class Bell:
    def __init__(self, horn: Horn, ring: Callable[[], str] | None = None) -> None:
        self.horn = horn


class Breaks:
    def __init__(self) -> None:
        raise KeyError("12: not there")


def make_wheel(radius: float = 0.2) -> Wheel:
    return Wheel(radius)


def beep(seconds: float = 1.0) -> str:
    return "beep" * int(seconds)


def here(name, **settings):
    return {"_target_": f"{__name__}.{name}", **settings}


WHEELS = {"wheels": [here("Wheel")]}
CART = here("Cart", **WHEELS)


def test_children_are_built_first_and_live_objects_reach_whoever_names_them():
    cart = build(here("Cart", wheels=[here("Wheel", radius=0.3), here("make_wheel")]), seats=4, seed=0)
    assert [wheel.radius for wheel in cart.wheels] == [0.3, 0.2]
    assert cart.seats == 4


def test_what_a_node_gives_goes_before_live_objects():
    assert build(here("Cart", **WHEELS, seats=2), seats=4).seats == 2


def test_a_class_that_passes_settings_on_takes_what_its_base_takes():
    truck = build(here("Truck", **WHEELS, load=3), seats=2)
    assert (truck.load, truck.seats) == (3, 2)
    assert takes(Truck) == ["load", "wheels", "lights", "kind", "limits", "seats"]
    with pytest.raises(ValueError, match=r"^truck.laod is no argument of .*Truck; did you mean load\?$"):
        check(here("Truck", **WHEELS, laod=3), "truck")


def test_a_part_is_built_when_it_is_called_and_anew_each_time():
    garage = build(here("Garage", car=CART, others={"big": CART, "none": None}))
    first, second = garage.car(seats=1), garage.car(seats=2)
    assert (first.seats, second.seats) == (1, 2)
    assert garage.others["big"](seats=3).seats == 3
    assert garage.others["none"] is None


def test_an_interpolation_and_a_missing_value_are_resolved_where_they_stand():
    assert plain(OmegaConf.create({"a": 1, "b": ["${a}"]})) == {"a": 1, "b": [1]}
    with pytest.raises(ValueError, match=r"^a.b is missing; give it as a.b=VALUE.$"):
        plain(OmegaConf.create({"a": {"b": "???"}}))


def test_a_node_with_partial_is_called_later():
    make = build(here("Wheel", _partial_=True, radius=0.5))
    assert make(name="front").radius == 0.5
    assert make(radius=1.0).radius == 1.0


def test_a_part_and_any_callable_are_supplied_alike():
    part = Part(here("Cart", **WHEELS), "cart")
    for factory in (part, partial(Cart, wheels=[Wheel()])):
        assert supply(factory, seats=3, seed=0).seats == 3
        assert setting(factory, "kind") == "small"
    assert setting(part.replace(kind="large"), "kind") == "large"
    with pytest.raises(ValueError, match=r"^cart.seats is missing.$"):
        setting(part, "seats")


def test_a_mapping_of_nodes_becomes_parts():
    parts = as_part({"a": CART, "b": None, "c": 1}, "cars")
    assert parts["a"].where == "cars.a"
    assert (parts["b"], parts["c"]) == (None, 1)


@pytest.mark.parametrize(
    ("node", "sentence"),
    [
        (here("Cart", **WHEELS, seat=1), "cart.seat is no argument of .*Cart; did you mean seats?"),
        (here("Cart", **WHEELS), "cart.seats is missing; .*Cart needs it."),
        (here("Cart", wheels=[3], seats=1), "cart.wheels[0] must be a Wheel, got 3."),
        (here("Cart", wheels={}, seats=1), "cart.wheels must be a list (each a Wheel), got a mapping without _target_."),
        (here("Cart", wheels=None, seats=1), "cart.wheels must be a list (each a Wheel), got null."),
        (here("Cart", wheels=[here("Bell")], seats=1), "cart.wheels[0]._target_ must make a Wheel, but .*Bell makes a Bell."),
        (here("Cart", **WHEELS, seats=1.5), "cart.seats must be a whole number, got 1.5."),
        (here("Cart", **WHEELS, seats=True), "cart.seats must be a whole number, got True."),
        (here("Cart", **WHEELS, seats=1, kind="huge"), "cart.kind must be one of small, large, got 'huge'."),
        (here("Cart", **WHEELS, seats=1, limits=[0]), "cart.limits must be a list of 2 (each a number), got [0]."),
        (here("Cart", **WHEELS, seats=1, limits=[0, "b"]), "cart.limits[1] must be a number, got 'b'."),
        (here("Cart", **WHEELS, seats=1, limits=[0, float("inf")]), "cart.limits[1] must be a finite number, got inf."),
        (here("Cart", **WHEELS, seats=1, lights=3), "cart.lights must be a mapping (each a Wheel or null) or null, got 3."),
        (here("Cart", **WHEELS, seats=1, lights={"a": 3}), "cart.lights.a must be a Wheel or null, got 3."),
        (here("Cart", wheels=[here("Wheel", radius=float("nan"))], seats=1), "cart.wheels[0].radius must be a finite number, got nan."),
        (here("Garage", car=None, others={}), "cart.car must be a Cart, got null."),
        (here("Garage", car=here("Wheel"), others={}), "cart.car._target_ must make a Cart, but .*Wheel makes a Wheel."),
        (here("Garage", car=here("Cart", seat=1), others={}), "cart.car.seat is no argument of .*Cart; did you mean seats?"),
        (here("Garage", car=CART, others={"a": here("make_wheel")}), "cart.others.a._target_ must make a Cart, but .*make_wheel makes a Wheel."),
        (here("Bell", horn=here("Wheel")), "cart.horn._target_ must make a Horn, but .*Wheel makes a Wheel."),
        (here("Carts"), "cart._target_: there is no .*Carts (No module named .*); did you mean .*Cart?"),
        ({"_target_": 3}, "cart._target_ must be the name of a class or function, got 3."),
        ({"_target_": "math.pi"}, "cart._target_: math.pi is a float, which cannot be called."),
    ],
)  # fmt: skip
def test_what_is_wrong_is_told_by_its_key_before_anything_is_built(node, sentence):
    pattern = "".join(".*" if piece == ".*" else escape(piece) for piece in pieces(sentence))
    for refuse in (check, build):
        with pytest.raises(ValueError, match=f"^{pattern}$"):
            refuse(node, "cart")


def pieces(sentence):
    first, *rest = sentence.split(".*")
    return [first, *(piece for part in rest for piece in (".*", part))]


def escape(piece):
    return "".join(f"\\{letter}" if letter in ".[]()?*+|^$" else letter for letter in piece)


@pytest.mark.parametrize(
    ("node", "sentence"),
    [
        (here("Wheel", radius=-1), "wheel.radius must be positive, got -1."),
        (here("Breaks"), "wheel: KeyError: '12: not there'"),
        (here("Cart", wheels=[here("Wheel", radius=0)], seats=1), "wheel.wheels[0].radius must be positive, got 0."),
    ],
)
def test_what_a_constructor_refuses_is_told_by_the_key_of_its_node_alone(node, sentence):
    check(node, "wheel")
    with pytest.raises(ValueError) as refused:  # noqa: PT011  (the whole message is compared)
        build(node, "wheel")
    assert str(refused.value) == sentence


def test_a_misplaced_key_is_told_where_it_belongs():
    root = here("Garage", car=here("Cart", **WHEELS, others=1), others={})
    with pytest.raises(ValueError, match=r"^car.others is no argument of"):
        check(root)
    root = here("Garage", car=CART, others={}, wheel=here("Wheel", car=3))
    with pytest.raises(ValueError, match=r"^wheel.car is no argument of .*; did you mean car at the root\?$"):
        check(root)


def test_functions_and_callables_serve_where_something_is_called():
    bell = build(here("Bell", horn=here("beep", _partial_=True)))
    assert bell.horn(seconds=2) == "beepbeep"


@pytest.mark.parametrize(
    ("value", "hint", "fit"),
    [
        (1, float, True),
        (True, float, False),
        (float("inf"), float, False),
        ("cpu", torch.device, True),
        (1, torch.device, False),
        (0.5, torch.Tensor, True),
        (None, nn.Module, False),
        ("linear", nn.Module, False),
        ("here", Path | None, True),
        (3, nn.Module, False),
        (1, Literal["1"], False),
        (None, Wheel | None, True),
        ("wheel", Sequence[str], False),
    ],
)
def test_values_fit_their_annotations(value, hint, fit):
    assert fits(value, hint) is fit


def test_annotations_are_told_in_words():
    assert describe(Sequence[str] | float) == "a list (each a word) or a number"
    assert describe(Part[Cart] | None) == "a Cart or null"
