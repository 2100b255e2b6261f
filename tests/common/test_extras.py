from __future__ import annotations

import re
import sys
from pathlib import Path

import numpy as np
import pytest

from sunarc.common import extras
from sunarc.common.errors import InputError
from sunarc.common.extras import extra_module, is_installed, missing_packages, require_extra
from sunarc.formats.exported import Table, Variable
from sunarc.formats.tables import netcdf_bytes


def test_a_module_that_is_there_is_returned() -> None:
    assert extra_module("json", extra="none") is sys.modules["json"]
    assert (is_installed("json"), is_installed("no_such_module")) == (True, False)


def test_a_module_that_is_not_installed_names_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "h5netcdf", None)
    table = Table(variables={"x": Variable(dimensions=(), values=np.array(0), attributes={})}, attributes={})
    with pytest.raises(InputError) as caught:
        netcdf_bytes(table)
    assert caught.value.field == "extra netcdf"
    assert "sunarc[netcdf]" in caught.value.remedy


def test_an_extra_that_is_not_whole_is_refused_with_the_line_that_installs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    stated = ["numpy>=2", "numpy>=2; extra == 'a'", "no-such.package[x]<3,>=2; extra == 'a'", "other; extra == 'b'"]
    monkeypatch.setattr(extras, "requires", lambda name: stated if name == "sunarc" else [])
    assert (missing_packages("a"), missing_packages("none")) == (["no-such.package"], [])
    with pytest.raises(InputError) as caught:
        require_extra("a", what="serve")
    assert (caught.value.field, caught.value.remedy) == ("serve", "pip install 'sunarc[a]'")
    require_extra("none", what="serve")


def test_the_package_has_its_extras_and_a_remedy_for_the_others_that_its_owner_can_follow(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Nobody can install an extra into the package's folder."""
    build = Path(__file__).parents[2] / "deploy" / "build-deb"
    (packed,) = re.findall(r"whl\)\[([a-z,]+)\]", build.read_text())
    assert tuple(packed.split(",")) == extras.PACKED
    assert "night" in extras.PACKED
    monkeypatch.setattr(extras, "_PACKAGED", Path(extras.__file__).parent)
    for extra, remedy in (("night", "deploy/install"), ("geotiff", "deploy/setup")):
        with pytest.raises(InputError) as caught:
            extra_module("no_such_module", extra=extra)
        assert remedy in caught.value.remedy
        assert f"sunarc[{extra}]" not in caught.value.remedy
