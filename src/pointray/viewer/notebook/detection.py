"""Detection of notebooks, and of the package that their widgets need."""

from __future__ import annotations

import importlib.util
import sys
from typing import Any


def in_notebook() -> bool:
    """Return whether the code runs in a notebook: Jupyter, JupyterHub, VS Code, Colab or marimo."""
    return cell_of_jupyter() is not None or _in_marimo()


def has_widgets() -> bool:
    """Return whether anywidget is installed."""
    return importlib.util.find_spec("anywidget") is not None


def cell_of_jupyter() -> tuple[str, str] | None:
    """Return the id of the running cell and the id of its execution; None outside of Jupyter's kernels.

    Both are empty if the notebook does not send them.
    """
    ipython = sys.modules.get("IPython")
    shell: Any = ipython.get_ipython() if ipython is not None else None
    # By name, since it need not be imported; Colab's shell is derived from it.
    if not any(base.__name__ == "ZMQInteractiveShell" for base in type(shell).__mro__):
        return None
    message = getattr(shell, "parent_header", None) or {}
    cell = message.get("metadata", {}).get("cellId", "")
    return str(cell), str(message.get("header", {}).get("msg_id", ""))


def _in_marimo() -> bool:
    marimo = sys.modules.get("marimo")
    return marimo is not None and bool(getattr(marimo, "running_in_notebook", bool)())
