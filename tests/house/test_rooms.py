"""A file holds one subject: none is a fragment of its only reader, none too long; a name stands for one class."""

from __future__ import annotations

import ast

import pytest
from tests.house import figures
from tests.house.figures import Module

LONGEST = 700
"""Lines of a file."""
FRAGMENT = 150
"""Lines below which a module that one other alone imports belongs into that one."""
LARGEST_FACE = 20
"""Names that a package may export."""
APART = {
    "sunarc.lab.simulation.serving": "app alone may choose the simulator",
    "sunarc.calibration.fit.level_evidence": "needs the equations of a fit; the judgement of a tilt stands below them",
    "sunarc.calibration.quality.day_clocks": "a model of its own, solved for each day; the checks of a fit ask it once",
    "sunarc.cli.commands": "what the entry points name",
    "sunarc.imager.workers.cycles": "of the core, which computes; its reader is a worker",
    "sunarc.imager.workers.replay": "a worker has a file of its own; the service alone makes it",
    "sunarc.hub.clocks": "of the core, which computes; its reader is a worker",
    "sunarc.hub.cloud_edges": "of the core, which computes; its reader is a worker",
    "sunarc.imaging.hdr": "of the core, which computes; its reader is a worker",
    "sunarc.imaging.transfer_faults": "of the core, which computes; its reader is a worker",
    "sunarc.imaging.image_circle": "of the core, which computes; its reader is the command line",
    "sunarc.lab.studies.figures": "imports matplotlib, which is of an extra, when something is drawn",
    "sunarc.lab.studies.reports": "of the studies it alone touches the disk; its reader is the command line",
    "sunarc.formats.virtualsky": "a format of its own; the table of formats has a row of it",
    "sunarc.imager.web.routes.obstructions": "the routes of one subject; the application includes them",
    "sunarc.sources.source_dates": "of the library, which reads names; its reader is the command line",
    "sunarc.calibration.quality.first_motion": "of the core, which computes; its reader is a worker",
}
"""Fragments that stay, each with its reason."""
PUBLIC = ["Calibration", "Sightings", "Site"]
"""Classes of `import sunarc` with units and arrays of a notebook; each holds the library's value of its name."""


@pytest.fixture(scope="module")
def modules() -> dict[str, Module]:
    return figures.modules()


def n_lines(module: Module) -> int:
    return len(module.text.splitlines())


def fragments(modules: dict[str, Module]) -> dict[str, str]:
    """Return the short modules that one other alone imports, packages apart, each with its reader."""
    users = figures.importers(modules)
    packages = {name.rpartition(".")[0] for name in modules}
    return {
        name: next(iter(users[name]))
        for name, module in modules.items()
        if name not in packages and len(users.get(name, ())) == 1 and n_lines(module) < FRAGMENT
    }


def test_no_module_is_a_fragment_of_its_only_reader(modules: dict[str, Module]) -> None:
    found = fragments(modules)
    assert {name: reader for name, reader in found.items() if name not in APART} == {}
    assert [name for name in APART if name not in found] == []  # no exception outlives its reason


def test_a_fragment_is_found() -> None:
    texts = {"sunarc.a": "from sunarc.b import f\n", "sunarc.b": "def f(): ...\n", "sunarc.c": "import sunarc.d\n"}
    texts |= {"sunarc.d": "x = 1\n" * FRAGMENT, "sunarc.e": "from sunarc import a\n"}
    made = {name: Module(name, text, ast.parse(text)) for name, text in texts.items()}
    assert fragments(made) == {"sunarc.a": "sunarc.e", "sunarc.b": "sunarc.a"}


def test_a_file_holds_no_more_than_one_subject_needs(modules: dict[str, Module]) -> None:
    assert [name for name, module in modules.items() if n_lines(module) > LONGEST] == []


def test_a_class_name_is_that_of_one_class(modules: dict[str, Module]) -> None:
    assert sorted(name for name, count in figures.class_names(modules).items() if count > 1) == PUBLIC
    wrappers = {name: module for name, module in modules.items() if module.room == "public"}
    assert [name for name in PUBLIC if figures.class_names(wrappers)[name] != 1] == []


def test_faces_are_small(modules: dict[str, Module]) -> None:
    faces = figures.faces(modules, figures.importers(modules))
    assert {name: size for name, size in faces.items() if size > LARGEST_FACE} == {}
