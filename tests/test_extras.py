from __future__ import annotations

import sys

import numpy as np
import pytest

from sunarc.errors import InputError
from sunarc.exports import Table, Variable, netcdf_bytes
from sunarc.extras import extra_module, is_installed


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
