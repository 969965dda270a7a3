"""Controls of the panel: how each is described to the page, and which values the page may send back."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ..base.arguments import Vector, check_flag, check_number, check_position


@dataclass(frozen=True)
class Control:
    """One row of the panel.

    Attributes
    ----------
    name : str
        The name of the value that it changes.
    kind : str
        choice, range, number, switch, color (sRGB), vector, button, note.
    options : list of (value, label), for a choice
    low, high, step : float, for a range; the limits of a number, whose step does not matter
    log : bool
        For a range: its slider is logarithmic.
    """

    name: str
    label: str
    kind: str
    value: Any = None
    options: Sequence[tuple[Any, str]] = ()
    low: float = -math.inf
    high: float = math.inf
    step: float = 0.0
    log: bool = False
    hint: str = ""

    def describe(self) -> dict[str, Any]:
        """The description that the page gets."""
        out: dict[str, Any] = {"name": self.name, "label": self.label, "kind": self.kind, "value": self.value}
        if self.kind == "choice":
            out["options"] = [list(option) for option in self.options]
        if self.kind == "range":
            out |= {"min": self.low, "max": self.high, "step": self.step, "log": self.log}
        return out | ({"hint": self.hint} if self.hint else {})

    def check(self, value: Any) -> Any:
        """A value that the page has sent; ValueError if this control cannot have it."""
        checked = getattr(self, f"_check_{self.kind}", self._refuse)(value)
        if isinstance(checked, float) and isinstance(self.value, int):
            if not checked.is_integer():
                raise ValueError(f"{self.name} must be a whole number, not {checked:g}")
            checked = int(checked)
        if self.kind in ("number", "range") and not self.low <= checked <= self.high:
            raise ValueError(f"{self.name} must lie between {self.low:g} and {self.high:g}, not {checked:g}")
        return checked

    def _refuse(self, value: Any) -> Any:
        raise ValueError(f"{self.name} has no value")

    def _check_choice(self, value: Any) -> Any:
        for known, _ in self.options:
            if type(known) is type(value) and known == value:
                return known
        raise ValueError(f"{self.name} cannot be {value!r}")

    def _check_number(self, value: Any) -> float:
        return check_number(value, self.name, "a number")

    _check_range = _check_number

    def _check_switch(self, value: Any) -> bool:
        return check_flag(value, self.name)

    def _check_vector(self, value: Any) -> Vector:
        return check_position(value, self.name)

    def _check_color(self, value: Any) -> Vector:
        color = self._check_vector(value)
        if not all(0 <= part <= 1 for part in color):
            raise ValueError(f"{self.name} must be a colour, not {value!r}")
        return color


@dataclass(frozen=True)
class Folder:
    """Controls under a common title."""

    title: str
    controls: Sequence[Control]
    open: bool = False

    def describe(self) -> dict[str, Any]:
        """The description that the page gets."""
        return {"title": self.title, "open": self.open, "controls": [c.describe() for c in self.controls]}
