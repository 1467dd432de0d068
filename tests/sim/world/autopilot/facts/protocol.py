"""Facts on identity, streams, arming, commands, parameters and signing."""

import math

from pymavlink.dialects.v20 import ardupilotmega as wire

from tests.sim.world.autopilot.autopilot_fixture import Bench, command, of_type, override, texts
from tests.sim.world.autopilot.facts.facts import (
    ACCEPTED,
    ARMING,
    DENIED,
    FAILED,
    PARAMETERS,
    STREAMS,
    UNSUPPORTED,
    fact,
)

KEY = bytes(range(1, 33))
ATTITUDE = 30


def ask(bench, message_id, hz):
    return bench.ack(command(511, message_id, 1e6 / hz))


def rate_hz(bench, name):
    return len(of_type(bench.run(10.0), name)) / 10.0


def put(bench, name, value):
    message = wire.MAVLink_param_set_message(1, 1, name.encode(), value, wire.MAV_PARAM_TYPE_REAL32)
    return of_type(bench.send(message), "PARAM_VALUE")


@fact(STREAMS, "HEARTBEAT: type 11, autopilot 3, 1/1, MAVLink 2, base_mode 65 in MANUAL and 193 armed")
def _():
    bench = Bench().ready()
    beat = of_type(bench.run(1.1, every=override()), "HEARTBEAT")[-1]
    assert (beat.type, beat.autopilot, beat.base_mode, beat.custom_mode) == (11, 3, 193, 0)
    assert (beat.get_srcSystem(), beat.get_srcComponent(), beat.get_msgbuf()[0]) == (1, 1, 0xFD)
    bench.send(command(400, 0))
    assert of_type(bench.run(1.1, every=override()), "HEARTBEAT")[-1].base_mode == 65


@fact(STREAMS, "commands 512 (148) and 520 give AUTOPILOT_VERSION of the version that runs")
def _():
    for firmware, minor in [("4.6", 6), ("4.7", 7)]:
        bench = Bench(firmware=firmware)
        for request in (command(512, 148), command(520, 1)):
            version = of_type(bench.send(request), "AUTOPILOT_VERSION")[0].flight_sw_version
            assert (version >> 24, version >> 16 & 255) == (4, minor)


@fact(STREAMS, "a message interval is at most 80 % of the loop: 4.6 caps silently")
def _():
    bench = Bench({"SCHED_LOOP_RATE": 50})
    assert ask(bench, ATTITUDE, 50) == ACCEPTED
    assert rate_hz(bench, "ATTITUDE") == 40.0


@fact(STREAMS, "a message interval beyond 80 % of the loop: 4.7 denies and changes nothing")
def _():
    bench = Bench({"SCHED_LOOP_RATE": 50}, firmware="4.7")
    assert ask(bench, ATTITUDE, 50) == DENIED
    assert rate_hz(bench, "ATTITUDE") == 1.0
    assert ask(bench, ATTITUDE, 40) == ACCEPTED
    assert rate_hz(bench, "ATTITUDE") == 40.0


@fact(STREAMS, "at SCHED_LOOP_RATE 200 exactly 50 Hz, in both versions")
def _():
    for firmware in ("4.6", "4.7"):
        bench = Bench(firmware=firmware)
        assert ask(bench, ATTITUDE, 50) == ACCEPTED
        assert rate_hz(bench, "ATTITUDE") == 50.0


@fact(STREAMS, "a parameter download slows ATTITUDE from 50 to 34 Hz")
def _():
    bench = Bench()
    ask(bench, ATTITUDE, 50)
    for _ in range(50):  # downloads that begin again keep one going
        bench.send(wire.MAVLink_param_request_list_message(1, 1))
        bench.run(0.2)
    assert abs(len(of_type(bench.got["boat"], "ATTITUDE")) / 10.0 - 34.0) < 1.0


@fact(STREAMS, "HIGHRES_IMU is denied on 4.6; accelerations are milli-g, at rest zacc about -1000")
def _():
    bench = Bench()
    assert ask(bench, 105, 10) == DENIED
    assert abs(of_type(bench.run(1.1), "RAW_IMU")[0].zacc + 1000) <= 1


@fact(STREAMS, "TIMESYNC: tc1 is ns since boot, ts1 echoed; time_unix_usec is 0 until a fix")
def _():
    bench = Bench()
    bench.run(2.0)
    reply = of_type(bench.send(wire.MAVLink_timesync_message(0, 77)), "TIMESYNC")[0]
    assert (reply.ts1, reply.tc1) == (77, bench.t_ns - bench.boot_ns)
    assert {m.time_unix_usec for m in of_type(bench.run(2.0), "SYSTEM_TIME")} == {0}


@fact(
    ARMING, "a refusal is ACK FAILED, then texts of severity 2; those on outputs begin with PreArm:; over 50 in chunks"
)
def _():
    bench = Bench({f"SERVO{n}_FUNCTION": 0 for n in range(1, 5)})
    bench.run(1.2, every=override())
    answers = bench.send(command(400, 1))
    assert (answers[0].get_type(), answers[0].result) == ("COMMAND_ACK", FAILED)
    assert texts(answers) == [(2, "PreArm: no motor, sail or scripting outputs defined")]
    chunks = of_type(bench.send(command(401)), "STATUSTEXT")
    assert [m.chunk_seq for m in chunks] == [0, 1]
    assert texts(chunks) == [(2, "PreArm: no motor, sail or scripting outputs defined")]


@fact(ARMING, "unknown mode FAILED, no custom flag DENIED, unknown command UNSUPPORTED")
def _():
    bench = Bench()
    bench.run(1.2, every=override())
    assert bench.ack(command(176, 1, 99)) == FAILED
    assert bench.ack(command(176, 0, 4)) == DENIED
    assert bench.ack(command(31000, 1)) == UNSUPPORTED


@fact(ARMING, "without GPS MANUAL and HOLD arm, ACRO, STEERING and GUIDED do not, LOITER is not entered")
def _():
    for mode, entered, armed in [(0, ACCEPTED, ACCEPTED), (4, ACCEPTED, ACCEPTED), (1, ACCEPTED, FAILED),
                                 (3, ACCEPTED, FAILED), (15, ACCEPTED, FAILED), (5, FAILED, ACCEPTED)]:  # fmt: skip
        bench = Bench()
        bench.run(1.2, every=override())
        assert bench.ack(command(176, 1, mode)) == entered
        assert bench.ack(command(400, 1)) == armed


@fact(ARMING, "a refused mode says so, an unknown one too; SET_MODE is obeyed without an answer")
def _():
    for mode, said in [(11, "Flight mode change failed"), (2, "No such mode 2")]:
        bench = Bench()
        bench.run(1.2, every=override())
        assert bench.ack(command(176, 1, mode)) == FAILED
        assert texts(bench.got["boat"])[-1] == (4, said)
        assert bench.send(wire.MAVLink_set_mode_message(1, 1, 4)) == [] and bench.rover.vehicle.modes.mode == 4


@fact(ARMING, "without receiver and overrides: Radio failsafe on, asked for and unasked")
def _():
    bench = Bench()
    bench.run(3.0)
    assert bench.ack(command(400, 1)) == FAILED
    assert texts(bench.got["boat"])[-1] == (2, "Arm: Radio failsafe on")
    assert (2, "PreArm: Radio failsafe on") in texts(bench.run(30.0))
    assert bench.ack(command(400, 1, 2989)) == ACCEPTED


@fact(ARMING, "sticks away from neutral keep it from arming, but for pitch")
def _():
    for channel, name in [(1, "Roll (RC1)"), (2, None), (3, "Throttle (RC3)"), (4, "Yaw (RC4)")]:
        bench = Bench()
        values = [1500] * 4 + [65535] * 4 + [0] * 10
        values[channel - 1] = 1700
        bench.run(1.2, every=wire.MAVLink_rc_channels_override_message(0, 0, *values))
        assert bench.ack(command(400, 1)) == (FAILED if name else ACCEPTED)
        assert not name or texts(bench.got["boat"])[-1] == (2, f"Arm: {name} is not neutral")


@fact(ARMING, "reboot: accepted only disarmed; silence, no pulses, then a new clock, disarmed, streams forgotten")
def _():
    bench = Bench().ready()
    ask(bench, ATTITUDE, 50)
    put(bench, "FS_TIMEOUT", 1.75)
    assert bench.ack(command(246, 1)) == FAILED
    bench.send(command(400, 0))
    assert bench.ack(command(246, 1)) == ACCEPTED
    assert bench.rover.outputs_us == (0,) * 16
    assert bench.send(command(410)) == bench.run(3.9, every=override()) == []
    got = bench.run(1.2)
    assert of_type(got, "HEARTBEAT")[0].custom_mode == 16
    assert len(of_type(got, "ATTITUDE")) == 1
    vehicle = bench.rover.vehicle
    assert vehicle.clock_ms < 1300 and not vehicle.modes.armed and vehicle.rc.last_input_ns is None
    assert (vehicle.parameters["FS_TIMEOUT"], vehicle.parameters["STAT_BOOTCNT"]) == (1.75, 2.0)


@fact(ARMING, "reboot: accepted armed with 20190226 as parameter 6")
def _():
    bench = Bench().ready()
    assert bench.ack(command(246, 1, 0, 0, 0, 0, 20190225)) == FAILED
    assert bench.ack(command(246, 1, 0, 0, 0, 0, 20190226)) == ACCEPTED
    assert bench.rover.outputs_us == (0,) * 16


@fact(PARAMETERS, "PARAM_SET echoes with index 65535; wrong type accepted, int8 300 clamps to 127")
def _():
    echo = put(Bench(), "FS_ACTION", 300.0)[0]
    assert (echo.param_value, echo.param_index, echo.param_type) == (127.0, 65535, 2)


@fact(PARAMETERS, "unknown names and NaN meet silence")
def _():
    for name, value in [("NOT_THERE", 1.0), ("FS_ACTION", math.nan)]:
        bench = Bench()
        assert put(bench, name, value) == []
        bench.run(0.5)
        assert not of_type(bench.got["boat"], "PARAM_VALUE")


@fact(PARAMETERS, "an integer is cut towards zero after adding 0.01; STAT_BOOTCNT may be written; names in any case")
def _():
    for name, value, kept in [("FS_ACTION", 2.7, 2.0), ("FS_ACTION", -2.7, -2.0), ("FS_ACTION", 2.995, 3.0),
                              ("STAT_BOOTCNT", 7.0, 7.0), ("fs_action", 1.0, 1.0)]:  # fmt: skip
        assert [m.param_value for m in put(Bench(), name, value)] == [kept]


@fact(PARAMETERS, "4.7 calls SYSID_MYGCS MAV_GCS_SYSID and SYSID_THISMAV MAV_SYSID, and knows no old name")
def _():
    bench = Bench({"MAV_GCS_SYSID": 1}, firmware="4.7")
    assert put(bench, "SYSID_MYGCS", 255.0) == []
    assert [m.param_id for m in put(bench, "MAV_GCS_SYSID", 255.0)] == ["MAV_GCS_SYSID"]
    bench.send(override(high=1700))
    assert bench.rover.vehicle.rc.radio_in_us[8] == 0
    bench.send(wire.MAVLink_param_request_list_message(1, 1))
    names = {m.param_id for m in of_type(bench.run(2.0), "PARAM_VALUE")}
    assert {"MAV_GCS_SYSID", "MAV_SYSID"} <= names and not names & {"SYSID_MYGCS", "SYSID_THISMAV"}


def signed_bench(serial):
    """A bench whose autopilot has been given a key over USB; peer "boat" is on `serial` and signs with it."""
    bench = Bench(serial_of=lambda peer: 0 if peer == "usb" else serial)
    bench.join("boat")
    bench.join("usb", component=190)
    bench.send(wire.MAVLink_setup_signing_message(1, 1, KEY, 1000), "usb")
    return bench


def is_signed(message):
    return bool(message.get_msgbuf()[2] & 1)


def sign(bench, key):
    signing = bench.senders["boat"].signing
    signing.secret_key, signing.sign_outgoing, signing.timestamp = key, True, 2000


@fact(PARAMETERS, "SETUP_SIGNING signs everything that is sent on every link")
def _():
    bench = signed_bench(1)
    got = bench.run(3.0)
    assert got and all(is_signed(m) for m in got)
    assert bench.rover.links["boat"].mav.signing.link_id == 1


@fact(PARAMETERS, "with signing set up unsigned is still accepted on SERIAL0 and rejected on SERIAL1")
def _():
    for serial, heard in [(0, True), (1, False)]:
        bench = signed_bench(serial)
        assert bool(bench.send(command(410))) is heard
        bench.send(override(high=1700))
        assert (bench.rover.vehicle.rc.radio_in_us[8] == 1700) is heard


@fact(PARAMETERS, "signed with the key is accepted, with another key or replayed it is not")
def _():
    bench = signed_bench(1)
    sign(bench, KEY)
    assert bench.ack(command(410)) == FAILED
    replay = command(410).pack(bench.senders["boat"])
    assert bench.rover.receive(replay, "boat", bench.t_ns)
    assert not bench.rover.receive(replay, "boat", bench.t_ns)
    sign(bench, bytes(32 * [7]))
    assert not bench.send(command(410))


@fact(PARAMETERS, "the key survives a reboot, is not taken while armed, and a key of zeros ends signing (source)")
def _():
    bench = signed_bench(0)
    bench.send(command(246, 1))
    bench.run(5.0)
    assert bench.rover.key.secret == KEY and is_signed(bench.got["boat"][-1])
    bench.ready()
    bench.send(wire.MAVLink_setup_signing_message(1, 1, bytes(32), 0), "usb")
    assert bench.rover.key.secret == KEY
    bench.send(command(400, 0))
    bench.send(wire.MAVLink_setup_signing_message(1, 1, bytes(32), 0), "usb")
    assert not any(is_signed(m) for m in bench.run(2.0))
