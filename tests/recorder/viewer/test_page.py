"""A plan in the browser: live, and on this machine only."""

from __future__ import annotations

import contextlib
import os
import re
import socket
import subprocess
import sys
import urllib.request
from html.parser import HTMLParser
from http.client import HTTPConnection
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

import numpy as np
import psutil
import pytest

from recorder.viewer import connection, web_page
from recorder.viewer.connection import PORT
from recorder.viewer.web_page import PageServer, private_link

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from http.client import HTTPResponse

    from conftest import Browser
    from PIL import Image

PLAN = """
import itertools
from pathlib import Path
from threading import Event
from pycram.bullet_world import BulletWorld, Object

BOX = '''<robot name="box"><link name="box"><visual><geometry><box size="0.9 0.9 0.9"/></geometry>
<material name="paint"><color rgba="{} {} {} 1"/></material></visual></link></robot>'''

world = BulletWorld()
places = list(itertools.product([0], [-1.8, -0.6, 0.6, 1.8], [0.5, 1.7]))
boxes = []
for color in itertools.product([0.2, 1], repeat=3):
    file = Path(f"box_{len(boxes)}.urdf")
    file.write_text(BOX.format(*color))
    boxes.append(Object(file.stem, "environment", file, places[len(boxes)]))
while not Path("seen").exists():
    Event().wait(0.05)
for box, place in zip(boxes, reversed(places)):
    box.set_position(place)
while not Path("seen again").exists():
    Event().wait(0.05)
"""


def scene(picture: Image.Image) -> Image.Image:
    """Where the page shows the world: its upper left, without the bars."""
    width, height = picture.size
    return picture.crop((0, height // 8, width * 58 // 100, height * 2 // 3))


def shades(picture: Image.Image) -> int:
    """How many shades cover a thousandth of a picture or more: 1 or 2 where nothing is, 20 with eight boxes."""
    _, counts = np.unique(np.asarray(picture).reshape(-1, 3) >> 5, axis=0, return_counts=True)
    return int((counts * 1000 > counts.sum()).sum())


@pytest.mark.costly
@pytest.mark.slow
@pytest.mark.usefixtures("usual_ports")
def test_a_plan_is_seen_in_the_browser_while_it_runs(
    pycram: Callable[..., subprocess.Popen[str]], browser: Browser, tmp_path: Path, until
) -> None:
    (tmp_path / "plan.py").write_text(PLAN)
    process = pycram("run", "plan.py", "--rerun=serve")
    assert process.stderr is not None
    line = process.stderr.readline()
    page = re.fullmatch(r"recorder: live at (http://127\.0\.0\.1:\d+/[\w-]{22}/\?\S*url=\S+)\n", line)
    assert page, line
    browser.call("Page.navigate", url=page[1] + "&renderer=webgl")
    assert {each.laddr.ip for each in listening(process)} == {"127.0.0.1"}, "nobody else is listened to"
    file = tmp_path / "page.png"
    until(lambda: shades(scene(browser.picture(file))) > 12, "boxes of all colours are seen", 300)
    pictures = [scene(browser.picture(file))]

    def rests() -> bool:
        pictures.append(scene(browser.picture(file)))
        return differing(*pictures[-2:]) < 0.001

    until(rests, "all has come", 300)
    (tmp_path / "seen").touch()
    until(lambda: differing(pictures[-1], scene(browser.picture(file))) > 0.01, "they have changed places", 300)
    (tmp_path / "seen again").touch()
    _, rest = process.communicate(timeout=60)
    assert process.returncode == 0, rest
    asked = browser.asked()
    assert any(url.endswith(".wasm") for url in asked), "the viewer comes from this machine"
    assert any(url.endswith("/records.rrd") for url in asked), "and so do the records"
    assert {urlsplit(url).hostname for url in asked} == {"127.0.0.1"}, "nobody else is asked, not even for a font"
    assert not browser.errors()


def listening(process: subprocess.Popen[str]) -> list[Any]:
    """The sockets that a process, and those that have come of it, listen on."""
    parent = psutil.Process(process.pid)
    sockets = [each for one in (parent, *parent.children(recursive=True)) for each in one.net_connections("inet")]
    return [each for each in sockets if each.status == psutil.CONN_LISTEN]


def differing(a: Image.Image, b: Image.Image) -> float:
    """Which part of two pictures differs clearly."""
    grey = [np.asarray(picture.convert("L"), dtype=int) for picture in (a, b)]
    return float((abs(grey[0] - grey[1]) > 40).mean())


FILES = {"index.html": b"a page", "re_viewer.js": b"a program", "re_viewer_bg.wasm": bytes(range(256)) * 1000}


def pieces() -> Iterator[bytes]:
    yield b"the first, "
    yield b"the second"


@pytest.fixture(scope="module")
def server() -> Iterator[PageServer]:
    made = PageServer(0, lambda: FILES, pieces)
    yield made
    made.shutdown()
    made.server_close()


def ask(server: PageServer, path: str, **headers: str) -> tuple[HTTPResponse, bytes]:
    connection = HTTPConnection("127.0.0.1", server.server_port, timeout=30)
    connection.request("GET", path, headers=headers)
    with connection.getresponse() as answer:
        content = answer.read()
    connection.close()
    return answer, content


def test_who_has_the_address_gets_the_page_and_its_records(server: PageServer) -> None:
    with urllib.request.urlopen(f"{server.address}?url=x", timeout=30) as page:
        assert page.read() == b"a page"
    at = f"/{server.token}"
    assert ask(server, f"{at}/re_viewer_bg.wasm")[1] == FILES["re_viewer_bg.wasm"]
    assert ask(server, f"{at}/records.rrd")[1] == b"the first, the second"
    assert ask(server, f"{at}/records.rrd", Origin=f"http://{server.host}")[1] == b"the first, the second"
    assert ask(server, f"{at}/none.js")[0].status == 404


@pytest.mark.parametrize("name", ["", "re_viewer.js", "records.rrd"])
def test_who_has_no_token_gets_nothing(server: PageServer, name: str) -> None:
    guesses = (
        "",
        "/",
        "/x/",
        f"/{server.token[:-1]}/",
        f"/{server.token}x/",
        f"/?token={server.token}/",
        "/%C3%A9/",
        "//",
    )
    for guess in guesses:
        answer, content = ask(server, f"{guess}{name}")
        assert (answer.status, content) == (403, b""), guess


@pytest.mark.parametrize("host", ["evil.example", "evil.example:{port}", "127.0.0.1", "localhost:{port}", ""])
def test_a_name_that_was_made_to_lead_here_is_refused(server: PageServer, host: str) -> None:
    answer, content = ask(server, f"/{server.token}/records.rrd", Host=host.format(port=server.server_port))
    assert (answer.status, content) == (421, b"")


@pytest.mark.parametrize("origin", ["http://127.0.0.1:1", "http://localhost:{port}", "https://app.rerun.io", "null"])
def test_no_other_page_may_read(server: PageServer, origin: str) -> None:
    answer, content = ask(server, f"/{server.token}/records.rrd", Origin=origin.format(port=server.server_port))
    assert (answer.status, content) == (403, b"")
    assert answer.getheader("Access-Control-Allow-Origin") is None


def own_addresses() -> list[str]:
    """Addresses of this machine but 127.0.0.1: of the loopback, and of its cards."""
    cards = [each.address for card in psutil.net_if_addrs().values() for each in card if each.family == socket.AF_INET]
    return ["127.0.0.2", *(address for address in cards if address != "127.0.0.1")]


@pytest.mark.parametrize("place", own_addresses())
def test_it_listens_on_the_loopback_alone(server: PageServer, place: str) -> None:
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection((place, server.server_port), timeout=30)


#: A machine of its own, as far as the network goes, with a page and something that listens everywhere; and another one
#: beside it, which asks for both.
MACHINE = """
import socket, subprocess, sys
from recorder.viewer.web_page import PageServer

ip = lambda *words: subprocess.run(["ip", *words], check=True)
with subprocess.Popen(
    ["unshare", "-n", sys.executable, "-c", sys.argv[1]], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
) as other:
    assert other.stdout.readline() == "begun\\n"
    ip("link", "set", "lo", "up")
    ip("link", "add", "name", "here", "type", "veth", "peer", "name", "there", "netns", str(other.pid))
    ip("address", "add", "192.0.2.1/24", "dev", "here")
    ip("link", "set", "here", "up")
    page, everywhere = PageServer(0, dict, None), socket.create_server(("", 0))
    print(other.communicate(f"{page.server_port} {everywhere.getsockname()[1]}\\n")[0])
"""
OTHER_MACHINE = """
import socket, subprocess

print("begun", flush=True)
ports = input().split()
for words in ("address add 192.0.2.2/24 dev there", "link set there up"):
    subprocess.run(["ip", *words.split()], check=True)
for port in ports:
    try:
        socket.create_connection(("192.0.2.1", int(port)), timeout=30).close()
        print("reached")
    except ConnectionRefusedError:
        print("refused")
"""


@pytest.mark.slow
@pytest.mark.needs("network namespaces")
def test_another_machine_is_refused() -> None:
    command = ["unshare", "-rn", sys.executable, "-c", MACHINE, OTHER_MACHINE]
    ended = subprocess.run(command, capture_output=True, text=True, check=False, timeout=100)
    assert ended.stdout.split() == ["refused", "reached"], ended.stderr


def listening_to(user: int, port: int) -> str:
    """What the system tells of who listens: this user at another port, and a user at this one."""
    return (
        "  sl  local_address rem_address   st tx_queue rx_queue tr tm->when retrnsmt   uid  timeout inode\n"
        f"   0: 0100007F:{port + 1:04X} 00000000:0000 0A 00000000:00000000 00:00000000 00000000 {os.getuid()} 0 1 1\n"
        f"   1: 0100007F:{port:04X} 00000000:0000 0A 00000000:00000000 00:00000000 00000000 {user} 0 2 1\n"
    )


def test_a_port_is_told_from_another_user_s(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.create_server(("127.0.0.1", 0)) as ours, socket.create_server(("", 0)) as everywhere:
        for listener in (ours, everywhere):
            assert connection.is_own(listener.getsockname()[1])
        port = ours.getsockname()[1]
    assert not connection.is_own(port), "nobody listens any more"
    monkeypatch.setattr(connection, "_SOCKETS", tmp_path / "tcp")
    for user, own in ((os.getuid(), True), (os.getuid() + 1, False)):
        (tmp_path / "tcp").write_text(listening_to(user, 9876))
        assert connection.is_own(9876) == own


def test_another_user_s_viewer_gets_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """It answers at the usual port; a viewer of this user's is started at another."""
    started: list[int] = []
    monkeypatch.setattr(connection, "answers", lambda _: True)
    monkeypatch.setattr(connection, "is_own", lambda _: False)
    monkeypatch.setattr(connection.ViewerWindow, "_start", lambda _, port: started.append(port))
    with socket.socket() as theirs:
        theirs.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        with contextlib.suppress(OSError):  # somebody's viewer is open
            theirs.bind(("127.0.0.1", PORT))
            theirs.listen()
        connection.ViewerWindow()._stderr.close()
    assert started
    assert PORT not in started


def test_the_page_may_contact_its_own_server_only(server: PageServer) -> None:
    answer, _ = ask(server, f"/{server.token}/")
    rules = dict(rule.split(maxsplit=1) for rule in str(answer.getheader("Content-Security-Policy")).split("; "))
    assert rules["connect-src"] == "'self' data: blob:"
    assert rules["default-src"] == "'self' data: blob:"
    assert answer.getheader("Referrer-Policy") == "no-referrer"


def test_a_port_that_somebody_has_is_refused(server: PageServer) -> None:
    with pytest.raises(OSError, match="in use"):
        PageServer(server.server_port, lambda: FILES, pieces)


def test_the_browser_is_called_with_a_file_that_only_its_user_can_read() -> None:
    page = "http://127.0.0.1:1234/secret/?a&url=b"
    with private_link(page) as link:
        file = Path(link.removeprefix("file://"))
        assert file.stat().st_mode & 0o777 == 0o600
        found: list[str] = []
        parser = HTMLParser()
        parser.handle_starttag = lambda _, attributes: found.append(dict(attributes).get("content") or "")  # type: ignore[method-assign]
        parser.feed(file.read_text())
        assert found == [f"0;url={page}"]
    assert not file.exists()


@pytest.mark.slow
def test_a_library_whose_program_fails_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(web_page, "_OPTIONS", ("--no-such-option",))
    with pytest.raises(web_page.ViewerGone, match=r"can't be read \(.+\)"):
        web_page.read_viewer_files()
