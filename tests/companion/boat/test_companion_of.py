"""What the interlock knows of us comes from the run file and the vessel file."""

from msgspec.structs import replace

from companion.boat.start_interlock import companion_of
from tests.support.drive_fixture import setup


def test_the_companion_is_what_the_configuration_says():
    told = setup()
    companion = companion_of(told)
    assert [channel for _, channel in companion.thrusters] == [9, 10, 11, 12]
    other = replace(told.run, mavlink=replace(told.run.mavlink, system_id=7))
    assert companion_of(type(told)(other, told.pilot, told.files)).system_id == 7
