"""The sink `zenoh`: what a node of ROS 2 by rmw_zenoh would see, and `j2a fleet`."""

import asyncio
import json
import struct
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest
import xxhash
import zenoh
from j2a_bridge.command_fleet import ask, lines, read_status
from j2a_bridge.ros_messages import RosMessages
from j2a_bridge.sink_request import SinkRequest, make_sink
from j2a_bridge.sinks.zenoh import FLEET, open_session
from j2a_bridge.topics import Topic

import j2a
from j2a.types.transds_file import read_transds

from .support import PATIENCE_S, TRANSDS, board_of, bridging, config_for, free_port, served, until

HASH = "RIHS01_893f27f2d0c94f6c987b3f402c93b264222f3d91d18b6415e0e15590a61f9ce8"
QUAD = "j2a_msgs::msg::dds_::Quad_"


@pytest.fixture
def locator():
    return f"tcp/127.0.0.1:{free_port()}"


class Peer:
    """Somebody else, who keeps what comes."""

    def __init__(self, locator):
        config = zenoh.Config()
        for key, value in {
            "mode": "client",
            "scouting/multicast/enabled": False,
            "connect/endpoints": [locator],
        }.items():
            config.insert_json5(key, json.dumps(value))
        self.session = zenoh.open(config)
        self.samples = []
        self.session.declare_subscriber("**", self.samples.append)

    def tokens(self):
        return {
            str(reply.ok.key_expr)
            for reply in self.session.liveliness().get("@ros2_lv/**", timeout=PATIENCE_S)
        }


async def with_peer(locator, work, text=None, option=""):
    device = board_of() if text is None else board_of(text)
    with served(device) as url:
        sink = f"zenoh:mode=router,listen={locator},node=arm{option}"
        async with bridging(config_for(url, sinks=(sink, "kept"))) as bridge:
            assert not bridge.runners[0].problem
            known = "_numbers" if option else "_parts"
            await until(lambda: "servo" in getattr(bridge.runners[0].sink, known))
            peer = await asyncio.to_thread(Peer, locator)
            try:
                return await work(device, peer, bridge)
            finally:
                peer.session.close()


def test_samples_are_under_the_keys_of_rmw_zenoh_with_its_attachment(locator):
    async def work(device, peer, bridge):
        found = []
        count = 0
        while len(found) < 3:
            count += 1
            device.sense("quad", 0, count, raw=True)
            await asyncio.sleep(0.02)
            found = [one for one in peer.samples if str(one.key_expr).startswith("0/quad/j2a")]
        tokens = await asyncio.to_thread(peer.tokens)
        zid = str(bridge.runners[0].sink._session.info.zid())
        return found, tokens, zid

    found, tokens, zid = asyncio.run(with_peer(locator, work))
    assert str(found[0].key_expr) == f"0/quad/{QUAD}/{HASH}"
    node = f"@ros2_lv/0/{zid}/0/0/NN/%/%/arm"
    assert node in tokens
    [token] = [one for one in tokens if f"/MP/%/%/arm/%quad/{QUAD}/{HASH}/" in one]
    assert token.endswith("/2::,5:,:,:,,")
    assert any("/MS/%/%/arm/%servo%cmd/" in one for one in tokens)
    numbers = []
    for one in found:
        sequence, stamp, size = struct.unpack_from("<qqB", one.attachment.to_bytes())
        gid = one.attachment.to_bytes()[17:]
        assert (size, len(gid)) == (16, 16)
        digest = xxhash.xxh3_128(token.encode()).digest()  # big-endian: high, low
        assert gid == digest[8:][::-1] + digest[:8][::-1]
        numbers.append(sequence)
        ros = RosMessages("jazzy")
        kind = "j2a_msgs/msg/Quad"
        store = ros.store_of(_descriptors())
        message = store.deserialize_cdr(one.payload.to_bytes(), kind)
        newest = message.times[0]
        assert stamp == newest.sec * 10**9 + newest.nanosec
    assert numbers == sorted(numbers)


def _descriptors():
    return read_transds(TRANSDS)


@pytest.mark.parametrize("option", ["", ",process=yes"])
def test_actuators_are_set_by_messages_of_both_types(locator, caplog, option):
    async def work(device, peer, bridge):
        ros = RosMessages("jazzy")
        store = ros.store_of(_descriptors())
        servo, floats = "j2a_msgs/msg/Servo", "std_msgs/msg/Float64MultiArray"
        own = store.serialize_cdr(store.types[servo]([], np.array([10, -20], "i1")), servo)
        layout = store.types["std_msgs/msg/MultiArrayLayout"]([], 0)
        command = store.serialize_cdr(store.types[floats](layout, np.array([33.0])), floats)
        far = store.serialize_cdr(store.types[floats](layout, np.array([101.0])), floats)
        keys = (
            "0/servo/j2a_msgs::msg::dds_::Servo_/TypeHashNotSupported",
            "0/servo/cmd/std_msgs::msg::dds_::Float64MultiArray_/TypeHashNotSupported",
        )
        await asyncio.to_thread(peer.session.put, keys[0], bytes(own))
        await until(lambda: ("servo", 1, -20) in device.was_set)
        await asyncio.to_thread(peer.session.put, keys[1], bytes(command))
        await until(lambda: ("servo", 0, 33) in device.was_set)
        count = len(device.was_set)
        for bad in (bytes(far), b"", b"\0\1\0\0\xff\xff\xff\xff"):
            await asyncio.to_thread(peer.session.put, keys[1], bad)
        await until(lambda: caplog.text.count("was not set") >= 3)
        assert len(device.was_set) == count

    asyncio.run(with_peer(locator, work, option=option))
    assert "servo is -100 % to 100 %, not 101 %" in caplog.text


def test_tokens_of_a_board_that_has_gone_go_with_it(locator):
    sink = make_sink(SinkRequest.parse(f"zenoh:mode=router,listen={locator}"), None)
    text = """
SENSOR(far, 0, f, M, 3, u16, none, (unit, cm))
SENSOR(level, 1, l, M, 1, u8, none)
ACTUATOR(servo, 2, s, M, 2, i8, 0)
"""
    descriptors = read_transds(text)
    topics = [Topic(one.name, "arm", one, descriptors) for one in descriptors.transducers]
    sink.open()
    peer = Peer(locator)
    try:
        found = [peer.tokens()]
        for topic in topics:
            sink.announce(topic)
            found.append(peer.tokens())
        # Its own type, and a range of each channel; its own type; its own type, and commands.
        assert [len(one - found[0]) for one in found] == [0, 4, 5, 7]
        for topic in reversed(topics):
            sink.retract(topic)
            del found[-1]
            assert peer.tokens() == found[-1]
    finally:
        peer.session.close()
        sink.close()


@pytest.mark.parametrize("domain", [0, 17])
def test_keys_and_tokens_have_the_domain_of_the_environment(locator, monkeypatch, domain):
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    sink = make_sink(SinkRequest.parse(f"zenoh:mode=router,listen={locator}"), None)
    sink.open()
    peer = Peer(locator)
    try:
        tokens = peer.tokens()
        assert tokens
        assert all(one.startswith(f"@ros2_lv/{domain}/") for one in tokens)
        assert sink._key("/quad", "a/msg/B", "hash") == f"{domain}/quad/a::msg::dds_::B_/hash"
    finally:
        peer.session.close()
        sink.close()


def test_a_peer_does_without_a_router(locator):
    sink = make_sink(SinkRequest.parse(f"zenoh:connect={locator}"), None)
    sink.open()
    sink.close()


def test_bridges_that_answer_badly_hide_no_other():
    def reply(key, data=None, *, is_good=True):
        payload = SimpleNamespace(to_bytes=lambda: data)
        good = SimpleNamespace(key_expr=f"{FLEET}/{key}", payload=payload)
        return SimpleNamespace(ok=good if is_good else None)

    def state(host):
        return json.dumps({**GOOD, "host": host}).encode()

    answers = [
        reply("a/1", is_good=False),
        reply("d/4", state("d")),
        reply("b/2", b"nonsense"),
        reply("c/3", state("c")),
    ]
    there = [reply(key) for key in ("e/5", "d/4", "b/2", "c/3", "a/1")]
    session = SimpleNamespace(
        get=lambda *_, **__: answers,
        liveliness=lambda: SimpleNamespace(get=lambda *_, **__: there),
    )
    found, silent = ask(session, 0.0)
    assert [one["host"] for one in found] == ["c", "d"]
    assert silent == ["a/1", "b/2", "e/5"]


@pytest.mark.parametrize("is_here", [False, True])
@pytest.mark.parametrize("count", [0, 1, 2])
def test_a_line_says_whether_the_board_is_here(is_here, count):
    [board] = GOOD["boards"]
    topics = [board["topics"][0] | {"name": f"t{number}"} for number in range(count)]
    found = list(lines({**GOOD, "boards": [board | {"is_here": is_here, "topics": topics}]}))
    assert len(found) == max(count, 1)
    for number, line in enumerate(found):
        assert line.split()[2] == ("here" if is_here else "gone")
        assert (f"t{number}" in line.split()) == bool(count)


def fleet(*words):
    command = [sys.executable, "-m", "j2a", "fleet", *words]
    return subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=False)


def test_fleet_tells_of_all_computers_and_of_a_board_that_moves(locator, monkeypatch):
    ports = free_port(), free_port()

    async def work():
        sinks = f"zenoh:mode=router,listen={locator}", f"zenoh:connect={locator}"
        configs = [
            config_for(f"tcp://127.0.0.1:{port}", sinks=(sink,), names="board")
            for port, sink in zip(ports, sinks, strict=True)
        ]
        async with bridging(configs[0]) as one, bridging(configs[1]) as other:
            one._host, other._host = "alpha", "beta"
            found = []
            for at in (0, 1, 0):
                with served(board_of(name="arm", serial="S1"), ports[at]):
                    await until(lambda at=at: "arm/quad" in (one, other)[at]._flows)
                    while True:
                        result = await asyncio.to_thread(fleet, "--connect", locator, "--json")
                        assert result.returncode == 0, result.stderr
                        bridges = json.loads(result.stdout)["bridges"]
                        here = [
                            (bridge["host"], board["name"], board["topics"][0]["name"])
                            for bridge in bridges
                            for board in bridge["boards"]
                            if board["is_here"] and board["topics"]
                        ]
                        if len(bridges) == 2 and len(here) == 1 and here[0][0] == _host(at):
                            break
                    table = await asyncio.to_thread(fleet, "--connect", locator)
                    found.append((here[0], table.stdout))
                await until(lambda: not one._flows and not other._flows)
            return found

    found = asyncio.run(work())
    assert [one for one, _ in found] == [
        ("alpha", "arm", "arm/quad"),
        ("beta", "arm", "arm/quad"),
        ("alpha", "arm", "arm/quad"),
    ]
    assert all("arm/tank/level" in table for _, table in found)


def test_another_bridge_takes_a_board_over_when_its_bridge_is_killed(locator):
    def start(url, sink):
        words = "-m", "j2a", "bridge", url, "--sink", f"zenoh:{sink}", "--names", "board"
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        return subprocess.Popen([sys.executable, *words], **quiet)

    def seen():
        """Of each bridge: the topics of the boards that it has."""
        result = fleet("--connect", locator, "--json")
        assert result.returncode in (0, 3), result.stderr
        bridges = json.loads(result.stdout)["bridges"] if result.returncode == 0 else []
        return sorted(
            [
                topic["name"]
                for board in one["boards"]
                if board["is_here"]
                for topic in board["topics"]
            ]
            for one in bridges
        )

    async def saw(what):
        while await asyncio.to_thread(seen) != what:
            await asyncio.sleep(0.1)

    topics = ["arm/quad", "arm/tank/level"]
    urls = [f"tcp://127.0.0.1:{free_port()}" for _ in range(3)]  # the last board is never there
    boards = [board_of(name="arm", serial="S1") for _ in range(2)]

    async def work(bridges):
        bridges.append(start(urls[2], f"mode=router,listen={locator}"))
        await saw([[]])
        bridges += [start(url, f"connect={locator}") for url in urls[:2]]
        with served(boards[0], int(urls[0].rpartition(":")[2])):
            await saw([[], [], topics])
            bridges[1].kill()  # its computer is gone, and nobody is told
            bridges[1].wait()
            await saw([[], []])
        with served(boards[1], int(urls[1].rpartition(":")[2])):
            await saw([[], topics])

    bridges = []
    try:
        asyncio.run(asyncio.wait_for(work(bridges), 2 * PATIENCE_S))
    finally:
        for one in bridges:
            one.terminate()
            one.wait(PATIENCE_S)


def _host(at):
    return ("alpha", "beta")[at]


def test_fleet_without_a_router_is_told_what_to_do(locator):
    result = fleet("--connect", locator)
    assert result.returncode == 3
    assert "start a router" in result.stderr
    assert "Traceback" not in result.stderr
    assert result.stderr.count("\n") == 1
    assert f"answers at {locator}: " in result.stderr
    assert ".rs" not in result.stderr


@pytest.mark.parametrize("locator", ["nowhere", "tcp/127.0.0.1:1+tcp://127.0.0.1:7447"])
def test_fleet_tells_what_a_locator_is(locator):
    result = fleet("--connect", locator)
    assert result.returncode == 2
    wrong = locator.rpartition("+")[2]
    assert f"{wrong!r} is no locator of Zenoh, such as tcp/192.168.1.5:7447" in result.stderr


@pytest.mark.parametrize(
    ("words", "file_mode", "mode"),
    [
        ("", "router", "router"),
        ("", None, None),
        ("mode=peer,", "router", "peer"),
        ("mode=client,", None, "client"),
    ],
)
def test_only_a_mode_that_was_named_replaces_that_of_the_file(
    tmp_path, monkeypatch, words, file_mode, mode
):
    opened = []
    monkeypatch.setattr(zenoh, "open", opened.append)
    path = tmp_path / "zenoh.json5"
    path.write_text(json.dumps({} if file_mode is None else {"mode": file_mode}))
    made = make_sink(SinkRequest.parse(f"zenoh:{words}file={path}"), None)
    open_session(made.options)
    [config] = opened
    assert json.loads(config.get_json("mode")) == mode


def test_without_a_file_it_is_a_peer(monkeypatch):
    opened = []
    monkeypatch.setattr(zenoh, "open", opened.append)
    open_session(make_sink(SinkRequest.parse("zenoh"), None).options)
    [config] = opened
    assert json.loads(config.get_json("mode")) == "peer"


@pytest.mark.parametrize("option", ["connect", "listen"])
def test_a_locator_that_is_none_is_refused_before_the_bridge_begins(option):
    with pytest.raises(j2a.LocalError, match="'nowhere' is no locator of Zenoh"):
        make_sink(SinkRequest.parse(f"zenoh:{option}=nowhere"), None)


def test_fleet_shows_no_place_in_sources_of_zenoh(tmp_path):
    path = tmp_path / "zenoh.json5"
    path.write_text('{"mode": "nothing"}')
    result = fleet("--file", path)
    assert result.returncode == 3
    assert "zenoh does not open: " in result.stderr
    assert ".rs" not in result.stderr


GOOD = {
    "host": "a",
    "sinks": [],
    "boards": [
        {
            "name": "n",
            "identity": "i",
            "url": "u",
            "is_here": True,
            "problem": "",
            "clock": "",
            "topics": [{"name": "t", "samples": 1, "rate_hz": 1.0, "latency_ms": None, "lost": 0}],
        }
    ],
}


def test_what_comes_is_checked():
    assert read_status(json.dumps(GOOD).encode()) == GOOD
    text = json.dumps(GOOD)
    for old, new in (
        ('"host": "a"', '"host": 1'),
        ('"name": "n"', '"name": null'),
        ('"is_here": true', '"is_here": 1'),
        ('"rate_hz": 1.0', '"rate_hz": "1"'),
        ('"rate_hz": 1.0', f'"rate_hz": {10**400}'),
        ('"rate_hz": 1.0', '"rate_hz": 1e300'),
        ('"rate_hz": 1.0', '"rate_hz": NaN'),
        ('{"host"', '{"more": ' + "[" * 500 + "]" * 500 + ', "host"'),
        ('"lost": 0', '"lost": true'),
        ('"latency_ms": null', '"latency_ms": []'),
        ('"topics": [', '"topics": [1, '),
        ('"boards": [', '"boards": [[], '),
        ('"host"', '"hast"'),
    ):
        assert old in text
        assert read_status(text.replace(old, new).encode()) is None, new
    no_lists = {**GOOD, "boards": {}}, {**GOOD, "boards": [{**GOOD["boards"][0], "topics": {}}]}
    for about in no_lists:
        assert read_status(json.dumps(about).encode()) is None
    for data in (b"", b"[]", b"1", b"\xff", b"[" * 100000, b'"' + b"x" * (1 << 20) + b'"'):
        assert read_status(data) is None


def certificates(folder):
    """Make an authority, and a certificate of it for a bridge and one for whoever asks."""

    def openssl(*words):
        subprocess.run(["openssl", *words], cwd=folder, check=True, capture_output=True)

    curve = "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-days", "30"
    openssl("req", "-x509", *curve, "-keyout", "ca.key", "-out", "ca.pem", "-subj", "/CN=ours")
    (folder / "names").write_text("subjectAltName=IP:127.0.0.1,DNS:localhost\n")
    for name in ("bridge", "asker"):
        openssl(
            "req", *curve, "-keyout", f"{name}.key", "-out", f"{name}.csr", "-subj", f"/CN={name}"
        )
        signed = "-CA", "ca.pem", "-CAkey", "ca.key", "-CAcreateserial", "-days", "30"
        openssl(
            *("x509", "-req", "-in", f"{name}.csr", *signed),
            *("-out", f"{name}.pem", "-extfile", "names"),
        )


def zenoh_file(folder, name, endpoints, **tls):
    config = {
        "scouting": {"multicast": {"enabled": False}},
        **endpoints,
        "transport": {"link": {"tls": {"root_ca_certificate": str(folder / "ca.pem"), **tls}}},
    }
    path = folder / f"{name}.json5"
    path.write_text(json.dumps(config))
    return str(path)


def test_with_tls_only_who_has_a_certificate_is_answered(tmp_path):
    certificates(tmp_path)
    where = f"tls/127.0.0.1:{free_port()}"

    def key_of(name, role):
        return {
            f"{role}_certificate": str(tmp_path / f"{name}.pem"),
            f"{role}_private_key": str(tmp_path / f"{name}.key"),
            "enable_mtls": True,
        }

    router = zenoh_file(
        tmp_path, "router", {"listen": {"endpoints": [where]}}, **key_of("bridge", "listen")
    )
    there = {"connect": {"endpoints": [where], "timeout_ms": 2000}}
    asker = zenoh_file(tmp_path, "asker", there, **key_of("asker", "connect"))
    stranger = zenoh_file(tmp_path, "stranger", there)

    async def work():
        with served(board_of()) as url:
            config = config_for(url, sinks=(f"zenoh:mode=router,file={router}",))
            async with bridging(config) as bridge:
                assert bridge.runners[0].problem == ""
                await until(lambda: bridge.runners[0].sink._status.host)
                good = await asyncio.to_thread(fleet, "--file", asker, "--json")
                bad = await asyncio.to_thread(fleet, "--file", stranger, "--json")
        return good, bad

    good, bad = asyncio.run(work())
    assert good.returncode == 0, good.stderr
    assert len(json.loads(good.stdout)["bridges"]) == 1
    assert bad.returncode != 0 or json.loads(bad.stdout)["bridges"] == []
