"""Options of `prepare`, checked before a file is read."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..base.arguments import check_choice, check_flag, check_path, check_whole, vector, wrong_type
from ..base.choices import AUTO, NORMALS
from ..cloud.denoising.smooth import check_sigma
from ..io.formats._source import Request
from ..io.selection import Selection
from ..io.trajectory import Trajectory
from ..surface.splats.scattered.spheres import Drawing, check_drawing
from .model_file import SAVED
from .out_of_core.prepare import check_unfinished
from .out_of_core.split import check_new
from .scan_inputs import check_result

Named = Callable[[str], str]
SEPARATORS = ("/", "\\")  # at the end of a folder's name
VALUES = {"fit": "normals='fit'", "file": "normals='file'", "force": "force=True"}
READ = (
    *("columns", "every", "max_points", "bounds", "keep", "drop"),
    *("resolution", "sample", "opacity", "intrinsics", "strict"),
)


def named_argument(what: str) -> str:
    """Return how messages name an option of `prepare`, or one of its values: "fit" gives "normals='fit'"."""
    return VALUES.get(what, what)


@dataclass(frozen=True)
class ReadOptions:
    """Which points `prepare` reads from its files, and how.

    request : options of the formats, such as the columns of a text file; selection : conditions on the rows to read
    drop_strays : whether to drop points that belong to no surface
    """

    request: Request = Request()
    selection: Selection = Selection()
    drop_strays: bool = False

    @property
    def unusual(self) -> list[str]:
        """Names of the options of reading that differ from the defaults."""
        found = []
        for name in READ:
            given, usual = (
                getattr(self.selection if hasattr(self.selection, name) else self.request, name)
                for self in (self, _READ_ALL)
            )
            if given is not usual and (usual is None or given != usual):
                found.append(name)
        return found + ["drop_strays"] * self.drop_strays


_READ_ALL = ReadOptions()


@dataclass(frozen=True)
class Cleaning:
    """Options of `prepare` that drop or move points.

    tolerance : drop points while the surface changes by at most this: a length, or a share of the diagonal like "0.05%"
    count : number of points to keep instead
    drop_duplicates, drop_outliers : drop equal positions; drop points far away from all others
    smooth : standard deviation of the noise to remove, or "auto"; None: no smoothing
    """

    tolerance: float | str | None = None
    count: int | None = None
    drop_duplicates: bool = False
    drop_outliers: bool = False
    smooth: float | str | None = None

    def limit(self, diagonal: float) -> float | None:
        """Return the tolerance in the points' unit; None if there is no tolerance.

        diagonal : length of the diagonal of the points' bounds, for a tolerance that is a share of it
        """
        if self.tolerance is None:
            return None
        share = isinstance(self.tolerance, str) and self.tolerance.endswith("%")
        return _number(self.tolerance) * (diagonal if share else 1.0)

    def check(self, named: Named) -> None:
        """Raise an error if an option is invalid.

        named : takes the name of an option and returns how messages name it, such as "--smooth" for "smooth"
        """
        if self.tolerance is not None:
            _check_tolerance(self.tolerance, named("tolerance"))
            if self.count is not None:
                raise ValueError(f"give either {named('tolerance')} or {named('count')}, not both")
        _check_from_one(self.count, named("count"))
        check_flag(self.drop_duplicates, named("drop_duplicates"))
        check_flag(self.drop_outliers, named("drop_outliers"))
        if self.smooth is not None:
            check_sigma(self.smooth, named("smooth"))


@dataclass(frozen=True)
class NormalsChoice:
    """Where the normals of a scan come from.

    normals : "auto" (the file's unless they are wrong), "file" or "fit" (estimated)
    viewpoint : (3,) scanner position that estimated normals face, or None
    trajectory : path of a moving scanner: `Trajectory`, path of a file, or None
    """

    normals: str = AUTO
    viewpoint: Any = None
    trajectory: Any = None

    def check(self, named: Named, drop_strays: bool) -> None:
        """Raise an error if an option is invalid, or does not apply to the others.

        named : takes the name of an option and returns how messages name it, such as "--viewpoint" for "viewpoint"
        drop_strays : whether strays are dropped
        """
        fitted = check_choice(self.normals, "normals", NORMALS) == "fit"
        if self.viewpoint is not None:
            vector(self.viewpoint, named("viewpoint"))
            if not (fitted or drop_strays):
                raise ValueError(f"{named('viewpoint')} requires {named('fit')} or {named('drop_strays')}")
        if self.trajectory is None:
            return
        if not isinstance(self.trajectory, Trajectory):
            check_path(self.trajectory, named("trajectory"))
        if not fitted:
            raise ValueError(f"{named('trajectory')} requires {named('fit')}")
        if self.viewpoint is not None:
            raise ValueError(f"{named('viewpoint')} and {named('trajectory')} exclude each other")


@dataclass(frozen=True)
class Storage:
    """The file or folder that `prepare` writes, and how.

    out : saved model or file of points; in_parts : whether to write a folder with a model in parts
    part_points : largest number of points of a part; memory : bytes of memory to use; None: default
    levels : whether a model gets levels of detail; force : whether `out` may be one of the inputs
    scatter, scatter_size : how a model draws points that lie on no surface, and a factor for their radii
    """

    out: Path
    in_parts: bool = False
    part_points: int | None = None
    memory: int | None = None
    levels: bool = True
    force: bool = False
    scatter: str = AUTO
    scatter_size: float = 1.0

    @property
    def is_model(self) -> bool:
        """Whether the result is a model (.pointray) instead of a file of points."""
        return self.out.suffix.lower() == SAVED

    @property
    def drawing(self) -> Drawing | None:
        """How a model draws points that lie on no surface; None if neither option differs from its default."""
        size = float(self.scatter_size)
        return None if self.scatter == AUTO and size == 1.0 else Drawing(self.scatter, size)

    def check(self, named: Named, shared: bool) -> None:
        """Raise an error if an option is invalid, or the result cannot be written.

        named : takes the name of an option and returns how messages name it, such as "--memory" for "memory"
        shared : whether workers of a cluster write the parts
        """
        check_drawing(self.scatter, self.scatter_size)
        for name in ("in_parts", "levels", "force"):
            check_flag(getattr(self, name), named(name))
        _check_from_one(self.part_points, named("part_points"))
        _check_from_one(self.memory, named("memory"))
        if not self.in_parts:
            for name in ("part_points", "memory", "client"):
                if shared if name == "client" else getattr(self, name) is not None:
                    example = f"{named('out')} {self.out.with_suffix(SAVED)}/"
                    raise ValueError(f"{named(name)} requires a model in parts: {example}")
            check_result(self.out, SAVED)
        elif not self.is_model:
            raise ValueError(f"{self.out}: a model in parts is a folder whose name ends in {SAVED}, like city{SAVED}/")
        elif not check_unfinished(self.out).exists():
            check_new(self.out)
        if self.drawing is not None and not self.is_model:
            both = f"{named('scatter')} and {named('scatter_size')}"
            raise ValueError(f"{both} require a model ({SAVED}), but {self.out.name} stores points")


@dataclass(frozen=True)
class PreparationOptions:
    """All options of `prepare`; invalid ones raise an error when this is created.

    Attributes
    ----------
    storage : Storage
        What to write.
    cleaning : Cleaning
        Which points to drop or move.
    normals : NormalsChoice
        Where normals come from.
    reading : ReadOptions
        Which points to read.
    shared : bool
        Whether workers of a client make the parts.
    named : callable
        Takes the name of an option, or "fit" or "file" (values of normals); returns how messages name it, such as
        "--memory" for "memory" on the command line.
    """

    storage: Storage
    cleaning: Cleaning = Cleaning()
    normals: NormalsChoice = NormalsChoice()
    reading: ReadOptions = ReadOptions()
    shared: bool = False
    named: Named = named_argument

    def __post_init__(self) -> None:
        check_flag(self.reading.drop_strays, self.named("drop_strays"))
        self.cleaning.check(self.named)
        self.normals.check(self.named, self.reading.drop_strays)
        self.storage.check(self.named, self.shared)

    @property
    def in_memory(self) -> list[str]:
        """Names of the given options that require all points in memory, so that a model cannot be made part by part."""
        cleaning, normals = self.cleaning, self.normals
        given = {
            "tolerance": cleaning.tolerance is not None,
            "count": cleaning.count is not None,
            "drop_duplicates": cleaning.drop_duplicates,
            "drop_outliers": cleaning.drop_outliers,
            "smooth": cleaning.smooth is not None,
            "fit": normals.normals == "fit",
            "trajectory": normals.trajectory is not None,
            "max_points": self.reading.selection.max_points is not None,
            "drop_strays": self.reading.drop_strays,
        }
        return [name for name, is_given in given.items() if is_given]


def _check_tolerance(value: float | str, name: str) -> None:
    wanted = "a positive number like 0.5, or like 0.05% of the diagonal"
    plain = value.item() if isinstance(value, np.generic) else value
    if isinstance(plain, bool) or not isinstance(plain, str | int | float):
        raise wrong_type(name, wanted, value)
    if not 0 < _number(value) < math.inf:
        raise ValueError(f"{name} must be {wanted}, not {value!r}")


def _number(value: float | str) -> float:
    """Return the number in a text or a number, a percentage as a share ("5%" is 0.05); NaN if it is neither."""
    try:
        if isinstance(value, str) and value.endswith("%"):
            return float(value[:-1]) / 100
        return float(value)
    except (ValueError, OverflowError):
        return math.nan


def _check_from_one(value: int | None, name: str) -> None:
    if value is None:
        return
    if isinstance(value, int) and value < 1:
        raise ValueError(f"{name} must be 1 or more, not {value}")
    check_whole(value, name, 1, or_none=True)
