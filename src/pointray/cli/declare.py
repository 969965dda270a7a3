"""Options as fields of frozen dataclasses, each declared once; `with_options` turns them into Typer's parameters."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import field, fields, is_dataclass
from enum import StrEnum
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, NamedTuple, get_type_hints

import typer
from typer.models import OptionInfo

INPUT, CAMERA, LIGHT, LOOK, QUALITY = "Input", "Camera", "Light", "Look", "Quality"
FILM, PAGE, OUTPUT, CLUSTER = "Film", "Page", "Output", "Cluster"
PANELS = (INPUT, CAMERA, LIGHT, LOOK, QUALITY, FILM, PAGE, OUTPUT, CLUSTER)  # in the order of --help


class Declaration(NamedTuple):
    """An option of the command line, declared once as a field of a dataclass that several commands share.

    Attributes
    ----------
    info : OptionInfo
        Help, panel (group in --help), flags and metavar, as Typer takes them.
    commands : tuple of str
        Names of the commands that have the option; empty: all that use the dataclass.
    part : str
        What the option belongs to, such as the table "camera" of scene files; the dataclass defines the names.
    kind : type or None
        Type on the command line; None: text if there is `parse`, otherwise that of the field.
    choices : tuple of str
        The accepted words; empty: any value of the type.
    parse : callable or None
        Takes the value from the command line and the option's name; raises ValueError if the value is invalid.
    """

    info: OptionInfo
    commands: tuple[str, ...]
    part: str
    kind: Any
    choices: tuple[str, ...]
    parse: Callable[[Any, str], Any] | None


def single(panel: str, metavar: str | None, help: str, *flags: str, **more: Any) -> Any:
    """Return an option that only one command has, as the annotation of a parameter.

    panel : group in --help; metavar : name of the value there, None for a flag
    flags : such as "-o"; empty: made from the parameter's name; more : keyword arguments of `typer.Option`
    """
    return typer.Option(*flags, metavar=metavar, help=help, rich_help_panel=panel, **more)


def option(
    default: Any,
    metavar: str | None,
    help: str,
    *flags: str,
    panel: str,
    commands: tuple[str, ...] = (),
    part: str = "",
    kind: Any = None,
    choices: Iterable[str] = (),
    parse: Callable[[Any, str], Any] | None = None,
    **more: Any,
) -> Any:
    """Return a dataclass field that declares an option of the command line, which several commands share.

    panel : group in --help; metavar : name of the value there, None for a flag
    flags : such as "--strict"; empty: made from the field's name
    commands : names of those that have it; empty: all that use the dataclass
    part : what it belongs to, such as the table "camera" of scene files
    kind : type on the command line; None: text if there is `parse`, otherwise that of the field
    choices : accepted words; empty: any value; parse : converts the value, is called with it and the option's name
    more : keyword arguments of `typer.Option`
    """
    info = single(panel, metavar, help, *flags, **more)
    declaration = Declaration(info, commands, part, kind, tuple(choices), parse)
    return field(default=default, metadata={"declaration": declaration})


def declarations(group: Any) -> dict[str, Declaration]:
    """Return the options that a dataclass declares, by the name of their field. group : class or instance"""
    return {each.name: each.metadata["declaration"] for each in fields(group)}


def parsed(group: Any, values: Mapping[str, Any]) -> Any:
    """Return an instance of a dataclass of options, made from values of the command line; ValueError if one is invalid.

    group : the dataclass; values : by field name; missing ones have their declared defaults
    """
    made = {each.name: each.default for each in fields(group)}
    made |= {name: getattr(value, "value", value) for name, value in values.items()}
    for name, declared in declarations(group).items():
        if declared.parse is not None and made[name] is not None:
            made[name] = declared.parse(made[name], f"--{name.replace('_', '-')}")
    return group(**made)


def with_options(*examples: str, **defaults: Any) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return a decorator for commands of Typer that have a dataclass of options as a parameter.

    The decorated command has one parameter for each option that the dataclass declares, sorted by groups of --help. It
    calls the original command with an instance of the dataclass.

    Parameters
    ----------
    *examples : str
        Command lines with which the help begins.
    **defaults
        Defaults of this command that differ from the declared ones.
    """

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        signature = inspect.signature(command, eval_str=True)
        groups = {name: p.annotation for name, p in signature.parameters.items() if is_dataclass(p.annotation)}
        names, parameters = {}, []
        for name, parameter in signature.parameters.items():
            own = [parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY)]
            if name in groups:
                own = list(_parameters(groups[name], command.__name__, defaults))
                names[name] = [each.name for each in own]
            parameters += own
        parameters.sort(key=_place)

        @wraps(command)
        def run(**values: Any) -> None:
            made = {
                name: parsed(group, {each: values.pop(each) for each in names[name]}) for name, group in groups.items()
            }
            try:
                command(**values, **made)
            finally:
                for file in values.get("files") or ():
                    if not isinstance(file, Path):  # a RemoteFile: its temporary copy is removed
                        file.release()

        run.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
        run.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
        lines = "".join(f"\n  {example}" for example in examples)
        paragraphs = [" ".join(text.split()) for text in str(inspect.getdoc(command)).split("\n\n")]
        run.__doc__ = "\n\n".join([f"\b\nExamples:{lines}", *paragraphs])
        return run

    return decorate


def _parameters(group: Any, command: str, defaults: dict[str, Any]) -> Iterable[inspect.Parameter]:
    """Yield the parameters that stand for the options of a dataclass in the signature of a command.

    group : the dataclass; command : name of the command, which may not have all options
    defaults : default values that replace the declared ones
    """
    hints = get_type_hints(group)
    default_of: dict[str, Any] = {each.name: each.default for each in fields(group)} | defaults
    for name, declared in declarations(group).items():
        if declared.commands and command not in declared.commands:
            continue
        default: Any = default_of[name]
        kind: Any = declared.kind or hints[name]
        if declared.parse is not None and declared.kind is None:
            kind = str if default is not None else str | None
        if declared.choices:
            words: Any = StrEnum(name.title(), list(declared.choices))  # type: ignore[misc]
            default, kind = (None, words | None) if default is None else (words(default), words)
        annotation = Annotated[kind, declared.info]
        yield inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


def _place(parameter: inspect.Parameter) -> int:
    """Return the position of a parameter's group in --help, to sort by; -1 for arguments, which come first."""
    info = next(iter(getattr(parameter.annotation, "__metadata__", ())), None)
    return PANELS.index(info.rich_help_panel) if isinstance(info, OptionInfo) else -1
