"""What stands in the tables of the report."""

from sim.fitting.identify.report.tables import band_text


def test_a_band_has_no_exponent():
    """Of the example boat's sway inertia and drag."""
    assert band_text((40.5, 225.0)) == "40 to 220"
    assert band_text((-551.0, -22.05)) == "-550 to -22"
