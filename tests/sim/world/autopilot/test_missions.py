"""The mission protocol, home, and what they change."""

from pymavlink.dialects.v20 import ardupilotmega as wire

from tests.sim.world.autopilot.autopilot_fixture import Bench, command, of_type, override, texts

ACCEPTED, ERROR, FAILED, DENIED, INVALID_SEQUENCE = 0, 1, 4, 14, 13


def item(seq, kind=0):
    return wire.MAVLink_mission_item_int_message(
        1, 1, seq, 3, 16, 0, 1, 0, 0, 0, 0, 129915000 + seq, 802337000, 0, kind
    )


def upload(bench, count, kind=0, peer="boat"):
    answers = bench.send(wire.MAVLink_mission_count_message(1, 1, count, kind), peer)
    for seq in range(count):
        assert [m.seq for m in of_type(answers, "MISSION_REQUEST")] == [seq]
        answers = bench.send(item(seq, kind), peer)
    return of_type(answers, "MISSION_ACK")[0]


def count(bench, kind=0):
    return of_type(bench.send(wire.MAVLink_mission_request_list_message(1, 1, kind)), "MISSION_COUNT")[0].count


def test_a_mission_goes_there_and_back():
    bench = Bench()
    ack = upload(bench, 3)
    assert (ack.type, ack.target_system, ack.target_component) == (ACCEPTED, 1, 191)
    assert (6, "Flight plan received") in texts(bench.got["boat"])
    assert (count(bench), count(bench, 1), count(bench, 2)) == (3, 0, 0)
    back = of_type(bench.send(wire.MAVLink_mission_request_int_message(1, 1, 2)), "MISSION_ITEM_INT")[0]
    assert (back.seq, back.frame, back.command, back.x, back.y) == (2, 3, 16, 129915002, 802337000)
    as_float = of_type(bench.send(wire.MAVLink_mission_request_message(1, 1, 2)), "MISSION_ITEM")[0]
    assert abs(as_float.x - 12.9915002) < 1e-6
    assert [m.param_value for m in of_type(bench.got["boat"], "PARAM_VALUE") if m.param_id == "MIS_TOTAL"][-1] == 3.0


def test_a_fence_is_a_list_of_its_own_and_clearing_one_leaves_the_other():
    bench = Bench()
    upload(bench, 2)
    upload(bench, 4, kind=1)
    bench.send(wire.MAVLink_mission_clear_all_message(1, 1, 0))
    assert (count(bench), count(bench, 1)) == (0, 4)


def test_while_one_uploads_another_is_denied_until_it_gives_up():
    bench = Bench()
    bench.join("gcs", system=255, component=190)
    bench.send(wire.MAVLink_mission_count_message(1, 1, 2))
    asks = wire.MAVLink_mission_request_list_message(1, 1)
    assert of_type(bench.send(asks, "gcs"), "MISSION_ACK")[0].type == DENIED
    assert of_type(bench.send(item(1)), "MISSION_ACK")[0].type == INVALID_SEQUENCE
    bench.run(9.0)
    assert of_type(bench.send(asks, "gcs"), "MISSION_COUNT")


def test_an_item_that_is_not_there_is_an_error_with_the_count():
    answers = Bench().send(wire.MAVLink_mission_request_int_message(1, 1, 7))
    assert {m.get_type() for m in answers} == {"MISSION_ACK", "MISSION_COUNT"}
    assert of_type(answers, "MISSION_ACK")[0].type == ERROR


def test_auto_is_entered_with_a_mission_alone_and_the_mission_survives_a_reboot():
    bench = Bench()
    bench.run(1.2, every=override())
    assert bench.ack(command(176, 1, 10)) == FAILED
    assert (5, "No Mission. Can't set AUTO.") in texts(bench.got["boat"])
    upload(bench, 2)
    bench.send(command(246, 1))
    bench.run(6.0, every=override())
    assert bench.ack(command(300)) == ACCEPTED
    assert bench.rover.vehicle.modes.mode == 10


def test_home_is_where_it_was_set():
    bench = Bench()
    assert bench.ack(command(410)) == bench.ack(command(179, 1)) == bench.ack(command(179, 0, 0, 0, 0, 91, 5)) == FAILED
    assert bench.ack(command(179, 0, 0, 0, 0, 12.99, 80.23)) == ACCEPTED
    home = of_type(bench.send(command(410)), "HOME_POSITION")[0]
    assert abs(home.latitude - 129900000) < 10 and abs(home.longitude - 802300000) < 60
