"""Lines of progress: they fit a terminal of 80 columns, do not flood a file, and say what is true to the end."""

import io

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.cli.boat.progress import COLUMNS, Progress
from companion.core.messages import Alert, ExcitationStatus, GuidanceReference, LoopTiming, OverrideLease, StateEstimate

S = 1_000_000_000


class Terminal(io.StringIO):
    def isatty(self):
        return True


def lease(t_ns, source="plan", reason=""):
    return OverrideLease(t_ns=t_ns, index=0, channels=(), pwm_us=(), valid_for_s=0.3, source=source, reason=reason,
                         f_command_n=())  # fmt: skip


def estimate(north_m=21.05, east_m=-12.26, u_m_s=0.5):
    return StateEstimate(
        t_ns=0, north_m=north_m, east_m=east_m, psi_rad=0.0, u_m_s=u_m_s, v_m_s=0.0, r_rad_s=0.0,
        covariance=(0.0,) * 36, accel_bias_m_s2=(0.0, 0.0), gyro_bias_rad_s=0.0, anchor_bias_m={},
        disturbance_n=(0.0,) * 3, health="healthy", reason="",
    )  # fmt: skip


def reference(y_e_m=-0.07, phase="leg"):
    return GuidanceReference(
        t_ns=0, phase=phase, leg=0, waypoints_passed=2, x_e_m=0.0, y_e_m=y_e_m, path_angle_rad=0.0, psi_ref_rad=0.0,
        u_ref_m_s=0.0, north_ref_m=0.0, east_ref_m=0.0,
    )  # fmt: skip


def shown(*messages, out=None):
    out = out or Terminal()
    progress = Progress(5, out)
    for message in messages:
        progress.see(message)
    return out.getvalue().split("\x1b[2K")[-1]


def test_a_line_of_a_mission():
    timing = LoopTiming(t_ns=0, index=0, lateness_ms=18.3, imu_to_override_ms=None)
    line = shown(estimate(), reference(), timing, lease(444 * S // 10))
    assert line == "   0.0 s  N  21.05 E -12.26 m   0.50 m/s  waypoint 2/5  y_e -0.07 m  late 18 ms"
    assert "by shifted plan" in shown(estimate(), reference(), lease(S, "shifted_plan"))


@given(st.floats(-1e5, 1e5), st.floats(-1e5, 1e5), st.floats(-1e4, 1e4), st.text(max_size=300), st.floats(0, 1e9),
       st.sampled_from(["plan", "shifted_plan", "pd", "neutral", "excitation", "manual"]))  # fmt: skip
def test_no_live_line_wraps(north_m, y_e_m, u_m_s, reason, late_ms, source):
    timing = LoopTiming(t_ns=0, index=0, lateness_ms=late_ms, imu_to_override_ms=None)
    flown = ExcitationStatus(t_ns=0, phase="fly", segment=1, segments=8, name=reason or "x", elapsed_s=3.2)
    line = shown(estimate(north_m, u_m_s=u_m_s), reference(y_e_m), flown, timing, lease(S, source, reason))
    assert len(line) <= COLUMNS < 80 and "\n" not in line


def test_a_narrow_terminal(monkeypatch):
    monkeypatch.setenv("COLUMNS", "40")
    assert len(shown(estimate(), reference(), lease(S))) <= 39


@pytest.mark.parametrize(("out", "lines"), [(Terminal(), 400), (io.StringIO(), 10)], ids=["terminal", "file"])
def test_a_file_gets_a_line_every_ten_seconds(out, lines):
    progress = Progress(5, out)
    for k in range(1000):
        progress.see(lease((1 + k) * S // 10))
    text = out.getvalue()
    assert max(text.count("\r"), text.count("\n")) == pytest.approx(lines, rel=0.2)


def test_alerts_come_at_once_and_whole():
    out = io.StringIO()
    Progress(5, out).see(Alert(t_ns=0, level="warning", text="y" * 200))
    assert out.getvalue() == f"warning: {'y' * 200}\n"


def test_the_last_words_are_that_the_run_ends():
    """The program's own stop at its end is not an operator's."""
    out = io.StringIO()
    progress = Progress(5, out)
    progress.ends()
    progress.see(lease(S, "neutral", "stopped by the operator"))
    assert "the run ends" in out.getvalue() and "operator" not in out.getvalue()
