"""The simulated imager's speed is a register, halved for a host that is too busy."""

from __future__ import annotations

from typing import cast

import pytest

from sunarc.lab.simulation import fake_camera as genicam
from sunarc.lab.simulation.fake_camera import FakeCamera
from sunarc.lab.simulation.imager import halve_speed


class Registers:
    """The registers of a camera, without the library."""

    def __init__(self, speed: float) -> None:
        self.values = {genicam.SPEED: round(1000.0 * speed)}

    def read(self, address: int) -> int:
        return self.values[address]

    def write(self, address: int, value: int) -> None:
        self.values[address] = value


@pytest.mark.parametrize(("before", "after"), [(500.0, 250.0), (31.25, 15.625), (15.0, 10.0), (10.0, 10.0), (1.0, 1.0)])
def test_the_speed_is_halved_down_to_a_lower_bound_and_never_raised(before: float, after: float) -> None:
    registers = Registers(before)
    halve_speed(cast("FakeCamera", registers))
    assert registers.values[genicam.SPEED] == pytest.approx(1000.0 * after, abs=1.0)
