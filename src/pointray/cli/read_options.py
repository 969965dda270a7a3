"""The options that choose which points of scans are read, for all commands that read scans."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from functools import partial
from typing import Any

from .declare import INPUT, option


def _names(text: str, name: str) -> tuple[str, ...]:
    """Parse names of columns, separated by commas. name : the option, which all parsers get; unused"""
    return tuple(part.strip() for part in text.split(","))


def _numbers(text: str, name: str, wanted: str) -> tuple[float, ...]:
    """Parse numbers separated by commas; raise ValueError if one is invalid.

    name : the option; wanted : description of valid values; both are for the message
    """
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"{name} must be {wanted}, not {text!r}") from None


def _choices(texts: list[str], name: str) -> dict[str, tuple[float, ...]] | None:
    """Parse values of --keep or --drop, such as `classification=ground,6`, into numbers by attribute; None if empty.

    The values of an attribute that is given twice are combined. name : the option, for messages
    """
    found: dict[str, tuple[float, ...]] = {}
    for text in texts:
        attribute, _, values = text.rpartition("=")
        if not attribute:
            raise ValueError(f"{name} must be like classification=2,6, not {text!r}")
        numbers = tuple(x for value in values.split(",") for x in _value(value.strip(), attribute, name))
        found[attribute] = tuple(dict.fromkeys((*found.get(attribute, ()), *numbers)))
    return found or None


def _value(text: str, attribute: str, name: str) -> tuple[float, ...]:
    """Parse one value of an attribute, a number or the name of a LAS class such as "ground"; return it as a 1-tuple.

    name : the option, for messages
    """
    if not text or text[0] in "+-." or text[0].isdigit():
        return _numbers(text, name, f"like {attribute}=2,6")
    from ..shade.attributes import ASPRS, is_classification

    names = (
        {label.replace(" ", "-"): code for code, (label, _) in ASPRS.items()} if is_classification(attribute) else {}
    )
    if text.lower().replace(" ", "-") not in names:
        known = f", or the name of a class: {', '.join(names)}" if names else ""
        raise ValueError(f"{name} must be like {attribute}=2,6{known}, not {text!r}")
    return (float(names[text.lower().replace(" ", "-")]),)


_bounds = partial(_numbers, wanted="x0,y0,z0,x1,y1,z1")
_intrinsics = partial(_numbers, wanted="fx,fy,cx,cy, perhaps ,steps")
_reading = partial(option, panel=INPUT)
_selection = partial(_reading, None, "NAME=VALUES", kind=list[str] | None, parse=_choices)


@dataclass(frozen=True)
class Reading:
    """The parsed values of the options that say how a scan is read, for all commands that read scans.

    They are the arguments of `pr.read` besides the files, and `drop_strays`: whether to remove strays afterwards. The
    defaults read all points.
    """

    columns: tuple[str, ...] | None = _reading(
        None,
        "NAMES",
        "Columns of a text file, or of a .bin file of float32, like x,y,z,r,g,b,intensity; - skips one. Default: "
        "detected.",
        parse=_names,
    )
    every: int = _reading(1, "STEP", "Read every n-th point.")
    max_points: int | None = _reading(None, "COUNT", "Read at most this many points, evenly spread over the file.")
    bounds: tuple[float, ...] | None = _reading(
        None, "BOX", "Read only points in the box x0,y0,z0,x1,y1,z1.", parse=_bounds
    )
    keep: Mapping[str, tuple[float, ...]] | None = _selection(
        "Read only points with these values, like classification=ground,6; repeatable."
    )
    drop: Mapping[str, tuple[float, ...]] | None = _selection(
        "Skip points with these values, like classification=low-noise,18; repeatable."
    )
    resolution: float | None = _reading(
        None, "LENGTH", "Coarsest sufficient spacing of a COPC file. Default: all points."
    )
    sample: int | None = _reading(
        None,
        "COUNT",
        "Number of points to sample on the triangles of a mesh; 0: use its vertices. Default: the vertices, or 200000 "
        "points if they are too far apart to show the surface.",
    )
    opacity: float = _reading(0.1, "OPACITY", "Skip Gaussian splats of lower opacity, 0 to 1.")
    intrinsics: tuple[float, ...] | None = _reading(
        None,
        "NUMBERS",
        "Intrinsics of a depth image that is read, fx,fy,cx,cy in pixels, then optionally ,steps per unit of length.",
        parse=_intrinsics,
    )
    strict: bool = _reading(
        False, None, "Reject files that are truncated, inconsistent, or refer to missing files.", "--strict"
    )
    drop_strays: bool = _reading(
        False,
        None,
        "Drop points off the surface: sparse second layers, veils, floating clusters, isolated points.",
        "--drop-strays",
    )

    def __post_init__(self) -> None:
        if self.arguments:
            from ..io.reading import check_reading

            try:
                check_reading(self.arguments)
            except ValueError as error:
                raise ValueError(_as_option(str(error))) from None

    @property
    def arguments(self) -> dict[str, Any]:
        """Keyword arguments of `pr.read`: the options whose values differ from their defaults."""
        return {name: getattr(self, name) for name in self.unusual if name != "drop_strays"}

    @property
    def unusual(self) -> list[str]:
        """Names of the options whose values differ from their defaults."""
        return [x.name for x in fields(self) if getattr(self, x.name) != x.default]

    @property
    def is_plain(self) -> bool:
        """Whether all options have their defaults: all points are read."""
        return not self.unusual

    @property
    def inputs(self) -> dict[str, Any]:
        """All options as JSON values, which identify cached models and interrupted animations made with them."""
        return asdict(self)

    @property
    def request(self) -> Any:
        """The options that readers of file formats need, such as columns and bounds, as their `Request`."""
        from ..io.files import request_of

        return request_of(
            self.columns, self.bounds, self.resolution, self.sample, self.opacity, self.intrinsics, self.strict
        )


def _as_option(message: str) -> str:
    """Replace the parameter at the beginning of a message by the option: "max_points ..." by "--max-points ..."."""
    name = next((each.name for each in fields(Reading) if message.startswith(each.name)), "")
    return f"--{name.replace('_', '-')}{message.removeprefix(name)}" if name else message
