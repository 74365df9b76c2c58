"""The server of the page: files, errors, policies and the address that it names."""

import itertools
import json
import socket
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Iterator

import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from quadwalk.errors import UsageError, UserError
from quadwalk.web.serve import SOCKET, PageServer, find_free_port, make_url, serve_page


def add_up(time: float, qpos: list[float], qvel: list[float], command: list[float]) -> list[float]:
    """Return the sum of a command as the target of every joint."""
    return [sum(command)] * 12


def fail() -> bytes:
    """Fail as a policy does that cannot be read."""
    raise UserError("the policy is damaged")


@pytest.fixture(scope="module")
def server() -> Iterator[PageServer]:
    """Yield a server of a few files, whose actor adds up the command."""
    files = {
        "index.html": b"<p>page",
        "main.js": b"1",
        "late.onnx": lambda: b"x",
        "bad": fail,
        "my run.onnx": b"y",
    }
    with serve_page("127.0.0.1", 8410) as server:
        server.set_files(files, lambda: add_up)
        yield server


def get(url: str) -> tuple[int, str, bytes]:
    """Return the status, the kind and the content of an answer."""
    try:
        with urllib.request.urlopen(url, timeout=10) as answer:
            return answer.status, answer.headers["Content-Type"], answer.read()
    except urllib.error.HTTPError as error:
        return error.code, error.headers["Content-Type"], error.read()


def test_files_are_served_with_their_kind(server):
    assert get(server.url) == (200, "text/html", b"<p>page")
    assert get(f"{server.url}/main.js?1") == (200, "text/javascript", b"1")
    assert get(f"{server.url}/late.onnx")[2] == b"x"
    assert get(f"{server.url}/my%20run.onnx")[2] == b"y"
    assert get(f"{server.url}/../pyproject.toml")[0] == 404
    assert get(f"{server.url}/bad") == (500, "text/plain", b"the policy is damaged")


def open_socket(server, origin: str | None = None):
    """Open the page's websocket as a page of `origin` does."""
    url = server.url.replace("http", "ws") + SOCKET
    return connect(url, additional_headers={"Origin": origin or server.url})


def test_pages_get_the_newest_policy_also_when_they_open_later(server):
    with open_socket(server) as early:
        early.send(json.dumps({"time": 0, "qpos": [], "qvel": [], "command": [1, 2, 3]}))
        assert json.loads(early.recv(10)) == [6] * 12
        server.send_policy(b"onnx")
        assert early.recv(10) == b"onnx"
        with open_socket(server) as late:
            assert late.recv(10) == b"onnx"


def test_another_site_cannot_use_the_websocket(server):
    with pytest.raises(InvalidStatus), open_socket(server, "http://elsewhere.example"):
        pass


@pytest.mark.parametrize("text", ["", "[]", '{"qpos": 1}', "nonsense", '{"qpos": []}'])
def test_what_no_page_sends_ends_its_connection_alone(server, text):
    with open_socket(server) as odd:
        odd.send(text)
    assert get(server.url)[0] == 200


def test_a_taken_port_is_passed_over():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
        assert find_free_port("127.0.0.1", port) > port


@pytest.mark.parametrize("host", ["1.2.3.4", "no such host", "a" * 300])
def test_a_wrong_host_is_one_line(host):
    with pytest.raises(UsageError, match=r"--host is .*; expected an address of this machine"):
        find_free_port(host, 8080)


def test_an_address_for_all_is_shown_as_one_that_works():
    assert make_url("127.0.0.1", 80) == "http://localhost:80"
    assert make_url("::1", 80) == "http://[::1]:80"
    assert "0.0.0.0" not in make_url("0.0.0.0", 80)


def receive(page, count: int) -> list[str]:
    """Return the next texts; skip bytes, which are policies that earlier tests have sent."""
    messages = (page.recv(10) for _ in range(count + 1))
    return list(itertools.islice((text for text in messages if isinstance(text, str)), count))


def test_a_training_and_its_pages_talk_through_the_server(server):
    """Check that the state of the desk also reaches pages that open later.

    A policy's states stay at the server.
    """
    received = []
    server.on_message = received.append
    desk, note = (json.dumps({"type": kind}) for kind in ("desk", "note"))
    with open_socket(server) as first, open_socket(server) as second:
        for page in (first, second):  # which are there once they are answered
            page.send(json.dumps({"time": 0, "qpos": [], "qvel": [], "command": [1]}))
            assert json.loads(receive(page, 1)[0]) == [1] * 12
        for text in (desk, "no message", note):
            server.forward(text)
        for page in (first, second):
            assert receive(page, 3) == [desk, "no message", note]
        first.send('{"type": "set",\n "name": "env.reward.energy.scale", "value": 1}')
        first.send(json.dumps({"time": 0, "qpos": [], "qvel": [], "command": [1]}))
        assert json.loads(receive(first, 1)[0]) == [1] * 12
    server.on_message = None
    assert [json.loads(text)["type"] for text in received] == ["set"]
    assert "\n" not in received[0]
    with open_socket(server) as late:
        assert receive(late, 1) == [desk]


def test_a_page_ends_with_its_training_where_ctrl_c_is_ignored():
    """Check it as in a script, which starts what is in the background with SIGINT ignored."""
    code = (
        "import signal, threading, time; signal.signal(signal.SIGINT, signal.SIG_IGN);"
        "from quadwalk.cli.process import run_command; from quadwalk.web.view import Relay;"
        "threading.Thread(target=Relay().read).start(); run_command(lambda: time.sleep(300))"
    )
    command = [sys.executable, "-c", code]
    process = subprocess.Popen(command, stdin=subprocess.PIPE)
    process.stdin.close()  # what the end of a training does
    try:
        assert process.wait(timeout=60) != 0
    finally:
        process.kill()
