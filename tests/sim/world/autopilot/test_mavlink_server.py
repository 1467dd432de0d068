import asyncio
import socket
import time

from pymavlink.dialects.v20 import ardupilotmega as wire

from sim.world.mavlink_server import MavlinkServer
from tests.sim.world.autopilot.autopilot_process import booted_rover, served, until


def parse(data):
    mav = wire.MAVLink(None)
    mav.robust_parsing = True
    return mav.parse_buffer(data) or []


def test_udp_talks_to_its_target_unasked_and_answers_whoever_speaks():
    async def scene():
        loop = asyncio.get_running_loop()
        target, stranger = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
        for s in (target, stranger):
            s.bind(("127.0.0.1", 0))
            s.setblocking(False)
        try:
            async with served(booted_rover(), udp_target=target.getsockname()) as (udp, _):
                first = parse(await asyncio.wait_for(loop.sock_recv(target, 2048), 2.0))
                question = wire.MAVLink_timesync_message(0, 42).pack(wire.MAVLink(None, 255, 190))
                stranger.sendto(question, udp)
                answer = parse(await asyncio.wait_for(loop.sock_recv(stranger, 2048), 2.0))
                return first, answer
        finally:
            target.close()
            stranger.close()

    first, answer = asyncio.run(scene())
    assert first[0].get_type() == "HEARTBEAT"
    assert (answer[0].get_type(), answer[0].ts1) == ("TIMESYNC", 42)


def test_a_dead_udp_target_does_not_stop_the_autopilot():
    async def scene():
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as gone:
            gone.bind(("127.0.0.1", 0))
            address = gone.getsockname()
        async with served(booted_rover(), udp_target=address) as (_, tcp):
            await asyncio.sleep(1.2)
            reader, writer = await asyncio.open_connection(*tcp)
            data = await asyncio.wait_for(reader.read(2048), 2.0)
            writer.close()
            return data

    assert parse(asyncio.run(scene()))[0].get_type() == "HEARTBEAT"


def test_a_udp_peer_is_forgotten_after_30_s_of_silence_and_the_target_is_not():
    async def scene():
        now_ns = time.monotonic_ns()
        rover = booted_rover()
        server = MavlinkServer(rover, lambda: now_ns)
        udp = await server.open_udp(("127.0.0.1", 0), ("127.0.0.1", 9))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as speaker:
            speaker.sendto(b"hello", udp)
            assert await until(lambda: len(rover.links) == 2)
        now_ns += 29_000_000_000
        server.send([])
        before = len(rover.links)
        now_ns += 2_000_000_000
        server.send([])
        after = set(rover.links)
        await server.close()
        await server.close()
        return before, after

    before, after = asyncio.run(scene())
    assert before == 2
    assert after == {("udp", ("127.0.0.1", 9))}


def test_a_tcp_client_that_leaves_is_forgotten_and_another_is_served():
    async def scene():
        rover = booted_rover()
        async with served(rover) as (_, tcp):
            for _ in range(2):
                reader, writer = await asyncio.open_connection(*tcp)
                assert parse(await asyncio.wait_for(reader.read(2048), 2.0))[0].get_type() == "HEARTBEAT"
                assert len(rover.links) == 1
                writer.close()
                assert await until(lambda: not rover.links)

    asyncio.run(scene())


def test_a_client_that_does_not_read_costs_no_memory():
    async def scene():
        rover = booted_rover()
        server = MavlinkServer(rover, time.monotonic_ns)
        tcp = await server.open_tcp(("127.0.0.1", 0))
        _, writer = await asyncio.open_connection(*tcp)
        assert await until(lambda: rover.links)
        peer = next(iter(rover.links))
        for _ in range(200):
            server.send([(peer, bytes(60_000))])
            await asyncio.sleep(0)
        waiting = server.waiting_bytes
        writer.close()
        await server.close()
        return waiting

    assert 0 < asyncio.run(scene()) <= 125_536
