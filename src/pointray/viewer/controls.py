"""Controls of the panel: their descriptions for the page, and checks of the values that the page sends."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ..base.arguments import Vector, check_flag, check_number, check_position


@dataclass(frozen=True)
class Control:
    """One row of the panel: a slider, menu, switch or other control, or a text.

    Attributes
    ----------
    name : str
        Name of the value that the control changes, such as "exposure" or "lamps.0.color"; of a button, its action.
    label : str
        Text shown beside it.
    kind : str
        "choice", "range", "number", "switch", "color" (sRGB), "vector", "button" or "note".
    value : object
        Current value; of a note, its text.
    options : sequence of (value, label)
        Options of a choice.
    low, high, step : float
        Limits and step of a range; limits of a number.
    log : bool
        Whether the slider of a range is logarithmic.
    hint : str
        Tooltip.
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
        """Return the control as a dict of JSON types, from which the page builds the row."""
        out: dict[str, Any] = {"name": self.name, "label": self.label, "kind": self.kind, "value": self.value}
        if self.kind == "choice":
            out["options"] = [list(option) for option in self.options]
        if self.kind == "range":
            out |= {"min": self.low, "max": self.high, "step": self.step, "log": self.log}
        return out | ({"hint": self.hint} if self.hint else {})

    def check(self, value: Any) -> Any:
        """Validate a value sent by the page; return it converted to the type of the control's value.

        Raise ValueError if the value is invalid for this control.
        """
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
    """Collapsible section of the panel: controls under a common title. open : whether it is expanded at first"""

    title: str
    controls: Sequence[Control]
    open: bool = False

    def describe(self) -> dict[str, Any]:
        """Return the folder and its controls as a dict of JSON types, from which the page builds the section."""
        return {"title": self.title, "open": self.open, "controls": [c.describe() for c in self.controls]}
