"""The tables of choices are used by all code, and documents name all choices."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import pytest

import pointray as pr
from helpers.clouds import sphere_points
from helpers.places import ROOT
from pointray.base import choices
from pointray.cli.scan_scene import ScanMaterial
from pointray.rendering.picture import KERNELS
from pointray.scenefile import shading
from pointray.shade.materials.base import Material

DOCS = ROOT / "docs"
SCENES = (DOCS / "scenes.md").read_text() if DOCS.exists() else ""


def test_choices_load_nothing() -> None:
    """`pointray --help` must be fast."""
    code = "import sys; old = set(sys.modules); import pointray.base.choices; print('numpy' in set(sys.modules) - old)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_saved_models_and_kernels_know_choices_by_these_numbers() -> None:
    """Old files stay readable: new choices are appended."""
    assert list(choices.SURFACES)[:4] == ["paper", "imls", "apss", "disc"]
    assert choices.number_of(choices.SURFACES, "apss") == 2


def test_every_integrator_has_a_kernel() -> None:
    assert KERNELS.keys() == choices.INTEGRATORS.keys()
    assert set(choices.NOISY) <= set(choices.EXPOSED) <= choices.INTEGRATORS.keys()


@pytest.mark.parametrize("name", choices.MATERIALS)
def test_every_material_of_the_command_line_can_be_made(name: str) -> None:
    points = pr.Points(sphere_points(100))
    assert isinstance(ScanMaterial(name).build(points, (0.0, 0.0, 1.0)), Material)


NAMED: dict[str, tuple[Any, list[str]]] = {
    "Settings": (pr.Settings.__doc__, [*choices.INTEGRATORS, *choices.FILTERS]),
    "Model": (pr.Model.__doc__, [*choices.SURFACES]),
    "Camera": (pr.Camera.look_at.__doc__, [*choices.PROJECTIONS]),
    "write_image": (pr.write_image.__doc__, [*choices.CURVES]),
    "frame": (pr.frame.__doc__, [*choices.VIEWS, choices.AUTO]),
    "scenes.md": (SCENES, [*choices.CURVES]),
}


@pytest.mark.parametrize("place", NAMED)
def test_documents_name_all_choices(place: str) -> None:
    text, names = NAMED[place]
    if not text:
        pytest.skip("no documents beside the tests")
    assert [name for name in names if f'"{name}"' not in text] == []


def test_the_document_of_scene_files_names_all_kinds() -> None:
    if not SCENES:
        pytest.skip("no documents beside the tests")
    ours = {kind for kind, made in shading.material_kinds().items() if made.__module__.startswith("pointray.")}
    assert [kind for kind in (*ours, *shading.LIGHTS) if kind not in SCENES] == []
