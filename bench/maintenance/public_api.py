"""Write tests/integration/public_api.txt, the listing of the public interface that tests/integration compares.

python -m bench.maintenance.public_api
"""

from __future__ import annotations

import inspect
import tomllib
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Any

from typer.main import get_command

import pointray as pr
from pointray import compat
from pointray.base import choices
from pointray.cli.commands import app
from pointray.scenefile import light, models, plan

ROOT = Path(__file__).resolve().parents[2]
TARGET = ROOT / "tests" / "integration" / "public_api.txt"
# Members that only the package uses: docs/stability.md excludes them.
INTERNAL = {"align_tree", "check_whole", "portable", "record", "tables"}
INTERNAL |= {f"Model.{name}" for name in ("data", "drawing", "longest", "place", "settings", "source", "step", "tree")}
INTERNAL |= {"Attribute.values", "Baked.coarser", "Baked.lacks_levels", "Scene.shown_attributes", "Scene.snapshot"}
OF_DEVELOPERS = {"dev", "docs", "release", "wheel"}  # extras
MARKS = {inspect.Parameter.VAR_POSITIONAL: "*", inspect.Parameter.VAR_KEYWORD: "**"}


def text_of(annotation: Any) -> str:
    """Return an annotation as it is in the source; the forward references of NamedTuples are unpacked."""
    return annotation if isinstance(annotation, str) else getattr(annotation, "__forward_arg__", str(annotation))


def default_of(value: Any) -> str:
    """Return a default value as text: the value of an enumeration, and "..." for a function."""
    return "..." if callable(value) else repr(getattr(value, "value", value))


def signature(function: Any, is_class: bool = False) -> str:
    """Return the parameters of a function, without private ones, and its result; the same in all Python versions."""
    found, words, keywords = inspect.signature(function), [], False
    for name, each in found.parameters.items():
        if name in ("self", "cls") or name.startswith("_"):
            continue
        if each.kind is each.KEYWORD_ONLY and not keywords:
            words.append("*")
        keywords = each.kind in (each.KEYWORD_ONLY, each.VAR_POSITIONAL)
        word = MARKS.get(each.kind, "") + name
        if each.annotation is not each.empty:
            word += f": {text_of(each.annotation)}"
        words.append(word if each.default is each.empty else f"{word} = {default_of(each.default)}")
    result = "" if is_class or found.return_annotation is found.empty else f" -> {text_of(found.return_annotation)}"
    return f"({', '.join(words)}){result}"


def member_lines(owner: type) -> Iterator[str]:
    """Yield the methods, properties and annotated attributes of a class, also those inherited from this package."""
    homes = [base for base in owner.__mro__ if base.__module__.startswith("pointray")]
    found = {name: value for base in reversed(homes) for name, value in vars(base).items() if name[0] != "_"}
    notes = {name: kind for base in reversed(homes) for name, kind in inspect.get_annotations(base).items()}
    fields = {name: text_of(kind) for name, kind in notes.items() if name[0] != "_"}
    for name in sorted(found.keys() | fields.keys()):
        value = found.get(name)
        if {name, f"{owner.__name__}.{name}"} & INTERNAL:
            continue
        if isinstance(value, property | cached_property):
            getter = value.fget if isinstance(value, property) else value.func
            settable = " (settable)" if isinstance(value, property) and value.fset else ""
            result = inspect.signature(getter).return_annotation if getter else "Any"
            yield f"    property {name}: {text_of(result)}{settable}"
        elif isinstance(value, classmethod | staticmethod):
            yield f"    {type(value).__name__} {name}{signature(value.__func__)}"
        elif inspect.isfunction(value):
            yield f"    method {name}{signature(value)}"
        elif name in fields:
            yield f"    attribute {name}: {fields[name]}"


def name_lines(prefix: str, module: Any) -> Iterator[str]:
    """Yield the public names of a module: classes with their members, and functions."""
    for name in sorted(module.__all__):
        value = getattr(module, name)
        if not inspect.isclass(value):
            yield f"function {prefix}{name}{signature(value)}" if callable(value) else f"constant {prefix}{name}"
            continue
        bases = [base.__name__ for base in value.__bases__ if base.__module__ == "builtins" and base is not object]
        call = "" if issubclass(value, BaseException) else signature(value, is_class=True)
        yield f"class {prefix}{name}{call}{' is a ' + ', '.join(bases) if bases else ''}"
        yield from member_lines(value)


def command_lines() -> Iterator[str]:
    """Yield the commands with their arguments and options: names, kind, default."""
    group: Any = get_command(app)
    for name, command in [("", group), *sorted(group.commands.items())]:
        yield f"command pointray {name}".rstrip()
        rows = []
        for option in command.params:
            names = " / ".join(filter(None, (" ".join(option.opts), " ".join(option.secondary_opts))))
            kind = "flag" if getattr(option, "is_flag", False) else option.metavar or ""
            marks = ["required"] * option.required + ["repeatable"] * (option.multiple or option.nargs == -1)
            default = "" if option.required or option.default is None else f" = {default_of(option.default)}"
            rows.append(" ".join(filter(None, (f"    {names}", kind, *marks))) + default)
        yield from sorted(rows)


def other_lines() -> Iterator[str]:
    """Yield keys of scene files, values of options, and what pyproject.toml declares for other programs."""
    tables = {"root": plan.ROOT, "camera": plan.LOOK_AT, "bake": light.WORDS, "models": models.WORDS}
    for table, words in tables.items():
        keys = (f"{name}: {' | '.join(word.types)}{' (required)' * word.required}" for name, word in words.items())
        yield from (f"scene file, {table}: {key}" for key in sorted(keys))
    for name, values in sorted(vars(choices).items()):
        if name.isupper() and isinstance(values, dict):
            yield f"values {name.lower()}: {', '.join(map(str, values))}"
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    yield f"requires Python {project['requires-python']}"
    yield from (f"extra {name}" for name in sorted(project["optional-dependencies"].keys() - OF_DEVELOPERS))
    for group, entries in [("console_scripts", project["scripts"]), *sorted(project["entry-points"].items())]:
        yield from (f"entry point {group}: {name} = {target}" for name, target in sorted(entries.items()))


def listing() -> str:
    """Return the listing."""
    names = [*name_lines("pointray.", pr), *name_lines("pointray.compat.", compat)]
    return "\n".join([*names, *command_lines(), *other_lines()]) + "\n"


if __name__ == "__main__":
    TARGET.write_text(listing(), encoding="utf-8")
    print(f"{TARGET.relative_to(ROOT)}: {len(listing().splitlines())} lines")
