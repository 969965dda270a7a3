"""The public interface equals the stored listing: see docs/stability.md."""

import difflib
import inspect
from dataclasses import dataclass, field
from enum import Enum
from types import SimpleNamespace

from bench.maintenance import public_api

ADVICE = "If the change is intended, run `python -m bench.maintenance.public_api` and describe it in CHANGELOG.md."


def changes(stored: str, found: str) -> list[str]:
    """Return the lines that were removed and added."""
    names = "public_api.txt", "this version"
    lines = difflib.unified_diff(stored.splitlines(), found.splitlines(), *names, n=0, lineterm="")
    return [line for line in lines if not line.startswith("@@")]


def test_the_public_interface_equals_the_listing():
    differences = changes(public_api.TARGET.read_text(encoding="utf-8"), public_api.listing())
    assert not differences, "\n".join([*differences, ADVICE])


class Kind(Enum):
    SMALL = "small"


@dataclass
class Thing:
    size: "float"
    names: "list[str]" = field(default_factory=list)

    @property
    def area(self) -> "float":
        return self.size**2

    @classmethod
    def of(cls, *parts: "int", kind: "Kind" = Kind.SMALL, key=len, _hidden: "int" = 0) -> "Thing":
        return cls(sum(parts))

    def _private(self) -> None: ...


def make(a, /, b: "int" = 1, *, c: "str | None" = None, **rest: "bool") -> "Thing":
    return Thing(b)


def test_the_listing_contains_signatures_members_and_defaults(monkeypatch):
    for each in (Thing, make):
        monkeypatch.setattr(each, "__module__", "pointray.thing")
    lines = list(public_api.name_lines("p.", SimpleNamespace(__all__=["make", "Thing"], Thing=Thing, make=make)))
    assert lines == [
        "class p.Thing(size: float, names: list[str] = <factory>)",
        "    property area: float",
        "    attribute names: list[str]",
        "    classmethod of(*parts: int, kind: Kind = 'small', key = ...) -> Thing",
        "    attribute size: float",
        "function p.make(a, b: int = 1, *, c: str | None = None, **rest: bool) -> Thing",
    ]


def test_every_internal_member_exists():
    """A member that is renamed leaves the list."""
    names = {name for name in dir(public_api.pr) if name[0] != "_"}
    owners = [owner for name in names if inspect.isclass(owner := getattr(public_api.pr, name))]
    members = {text for owner in owners for name in known(owner) for text in (name, f"{owner.__name__}.{name}")}
    assert members >= public_api.INTERNAL


def known(owner: type) -> set[str]:
    """Return the names of members and annotated attributes of a class, also inherited ones."""
    return {*dir(owner), *(name for base in owner.__mro__ for name in inspect.get_annotations(base))}


def test_changes_are_shown():
    assert changes("class A\n    method b()\n", "class A\n    method b(c)\n") == [
        "--- public_api.txt",
        "+++ this version",
        "-    method b()",
        "+    method b(c)",
    ]
