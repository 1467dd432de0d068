"""Replay: a log of a run repeats bit for bit; whatever was changed in it shows at its own step."""

import msgspec
import pytest
from mcap.opcode import Opcode

from companion.__main__ import main
from companion.boat.recorder import Recorder
from companion.core import messages as m
from companion.logs.log_file import LogFile
from companion.logs.metadata import log_metadata
from companion.logs.replay import replay
from companion.logs.schema import KINDS
from tests.companion.command_line import exit_code
from tests.fault_lab.broken_logs import headers
from tests.support.drive_fixture import driving, pilot, setup, voyage


def recorder_at(path, now_ns):
    metadata = log_metadata("aritra", setup().files)
    return Recorder(path, metadata, now_ns, wall_offset_ns=10**18, background=False)


class LoggingPilot:
    """The pilot, with every call written to a log before anything follows from it."""

    def __init__(self, inner, recorder):
        self.inner, self.recorder = inner, recorder
        self.settings, self.channels, self.initial = inner.settings, inner.channels, inner.initial

    def step(self, state, inputs, t_ns):
        for message in inputs:
            self.recorder.record(message)
        self.recorder.record(m.StepMark(t_ns=t_ns, inputs=len(inputs)))
        after, outputs = self.inner.step(state, inputs, t_ns)
        for output in outputs:
            self.recorder.record(output)
        return after, outputs


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """14 s of a run with seed 31, some of it under way."""
    path = tmp_path_factory.mktemp("replay") / "run.mcap"
    clock = [0]
    with recorder_at(path, lambda: clock[0]) as recorder:
        run = voyage(31, wrap=lambda inner: LoggingPilot(inner, recorder))

        def tick(run):
            clock[0] = run.world.t_ns
            return run.world.t_ns > 14 * 10**9

        run.run(tick, 20.0)
        assert driving(run)
    return path


@pytest.fixture(scope="module")
def logged(log):
    return list(LogFile(log).messages())


def test_a_run_repeats_bit_for_bit(logged):
    report = replay(pilot(), logged)
    assert report.difference is None
    assert report.steps == marks(logged) > 700
    assert report.outputs == sum(isinstance(x, m.OUTPUTS) for x in logged) > 1000
    assert any(isinstance(x, m.PlanResult) for x in logged)


def test_the_command_says_so(log, capsys):
    assert main(["replay", str(log)]) == 0
    assert "no difference" in capsys.readouterr().out


def marks(messages):
    return sum(isinstance(x, m.StepMark) for x in messages)


def changed(logged, kind, field, value, number):
    """The log with one field of the n-th message of a kind changed; the step it belongs to."""
    place = [i for i, x in enumerate(logged) if isinstance(x, kind)][number]
    other = msgspec.structs.replace(logged[place], **{field: value(getattr(logged[place], field))})
    return [*logged[:place], other, *logged[place + 1 :]], marks(logged[:place]) + 1


@pytest.mark.parametrize(
    ("kind", "field", "value", "number"),
    [
        (m.ImuSample, "ax_m_s2", lambda a: a + 1e-9, 500),
        (m.Attitude, "psi_rad", lambda psi: psi + 1e-9, 500),
        (m.PlanResult, "f_n", lambda f: ((f[0][0] + 1e-6, *f[0][1:]), *f[1:]), 20),
        (m.UwbRanges, "ranges", lambda r: (msgspec.structs.replace(r[0], range_m=r[0].range_m + 0.001), *r[1:]), 7),
    ],
    ids=["imu", "attitude", "plan", "ranges"],
)
def test_a_changed_input_shows_at_its_own_step(logged, kind, field, value, number):
    altered, at = changed(logged, kind, field, value, number)
    difference = replay(pilot(), altered).difference
    assert difference is not None and difference.step == at
    assert difference.logged != difference.replayed


@pytest.mark.parametrize(
    ("kind", "number"), [(m.OverrideLease, 90), (m.StateEstimate, 40), (m.Innovation, 200), (m.SolveRequest, 5)]
)
@pytest.mark.long
def test_a_changed_missing_or_added_output_is_found(logged, kind, number):
    place = [i for i, x in enumerate(logged) if isinstance(x, kind)][number]
    step = marks(logged[:place])
    missing, twice = logged[:place] + logged[place + 1 :], logged[: place + 1] + logged[place:]
    other = [*logged[:place], msgspec.structs.replace(logged[place], t_ns=logged[place].t_ns + 1), *logged[place + 1 :]]
    for altered in (missing, twice, other):
        assert replay(pilot(), altered).difference.step == step


def test_a_lost_input_is_found(logged):
    place = [i for i, x in enumerate(logged) if isinstance(x, m.ImuSample)][200]
    step = marks(logged[:place])
    difference = replay(pilot(), logged[:place] + logged[place + 1 :]).difference
    assert difference.step == step and "in the log" in difference.replayed


def test_alerts_of_the_shell_are_no_difference(logged):
    alert = m.Alert(t_ns=0, level="warning", text="the solver is still busy")
    place = [i for i, x in enumerate(logged) if isinstance(x, m.StepMark)][50] + 1
    altered = [*logged[:place], alert, *logged[place:]]
    assert replay(pilot(), altered).difference is None


@pytest.mark.long
def test_a_log_that_breaks_off_is_repeated_as_far_as_it_goes(logged):
    for end in (len(logged) // 2, len(logged) // 2 + 1, len(logged) - 7):
        assert replay(pilot(), logged[:end]).difference is None


def test_a_difference_is_printed_with_exit_code_1(tmp_path, logged, capsys):
    altered, at = changed(logged, m.Attitude, "psi_rad", lambda psi: psi + 1.0, 500)
    path = write(tmp_path / "altered.mcap", log_metadata("aritra", setup().files), altered)
    assert main(["replay", str(path)]) == 1
    told = capsys.readouterr().out
    assert f"first difference in step {at}," in told
    assert "logged" in told and "replayed" in told


def chunk_bytes(data, number):
    """Where a chunk of a log begins and ends."""
    starts = headers(data)
    place = [k for k, at in enumerate(starts) if data[at] == Opcode.CHUNK][number]
    return starts[place], starts[place + 1]


@pytest.mark.parametrize("cut_out", [False, True], ids=["damaged", "cut out"])
def test_a_log_that_lacks_messages_before_the_difference_says_nothing_of_the_core(tmp_path, log, capsys, cut_out):
    data = log.read_bytes()
    begin, end = chunk_bytes(data, 5)
    path = tmp_path / "run.mcap"
    path.write_bytes(data[:begin] + (b"" if cut_out else bytes(end - begin)) + data[end:])
    assert main(["replay", str(path)]) == 2
    told = capsys.readouterr()
    assert "first difference in step " in told.out
    assert f"{path}: lacks messages before this difference, which therefore says nothing of the core" in told.err
    assert ("damaged: " in told.err) is not cut_out


def test_a_log_of_another_version_says_nothing_of_the_core(log, capsys, monkeypatch):
    """Its attitudes do not fit the class of this version."""
    monkeypatch.setitem(KINDS, "/attitude", m.Battery)
    assert main(["replay", str(log)]) == 2
    told = capsys.readouterr()
    assert "/attitude: " in told.err and "messages do not fit their class in this version: left out" in told.err
    assert "first difference in step " in told.out and "which therefore says nothing of the core" in told.err


def test_what_is_missing_after_the_difference_excuses_nothing_and_is_told(tmp_path, logged, capsys):
    altered, at = changed(logged, m.Attitude, "psi_rad", lambda psi: psi + 1.0, 300)
    path = write(tmp_path / "altered.mcap", log_metadata("aritra", setup().files), altered)
    data = path.read_bytes()
    begin, end = chunk_bytes(data, -2)
    path.write_bytes(data[:begin] + bytes(end - begin) + data[end:-1000])
    assert main(["replay", str(path)]) == 1
    told = capsys.readouterr()
    assert f"first difference in step {at}," in told.out
    assert "damaged: " in told.err and "ends without footer" in told.err and "lacks" not in told.err


def write(path, metadata, messages=()):
    with Recorder(path, metadata, lambda: 0, wall_offset_ns=0, background=False) as recorder:
        for message in messages:
            recorder.record(message)
    return path


@pytest.mark.parametrize(
    ("metadata", "words"),
    [
        ({}, "holds no configuration"),
        ({"config/run.toml": "x", "config/vessel.toml": "x"}, "site.toml, mission."),
        ({"config/run.toml": "spam = 1", "config/vessel.toml": "", "config/site.toml": "", "config/mission.toml": ""},
         "run.toml: "),
    ],
    ids=["none", "parts", "bad"],
)  # fmt: skip
def test_a_log_without_its_configuration_is_refused(tmp_path, capsys, metadata, words):
    path = write(tmp_path / "bare.mcap", metadata)
    assert main(["replay", str(path)]) == 2
    told = capsys.readouterr().err
    assert str(path) in told and words in told


def test_a_log_without_a_step_is_refused(tmp_path, capsys):
    path = write(tmp_path / "empty.mcap", log_metadata("aritra", setup().files))
    assert main(["replay", str(path)]) == 2
    assert "holds no step" in capsys.readouterr().err


def test_no_log_at_all_is_refused(tmp_path, capsys):
    assert exit_code("replay", tmp_path / "none.mcap") == 2
    assert "none.mcap: No such file" in capsys.readouterr().err
