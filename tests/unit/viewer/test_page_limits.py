"""Access control of the viewer, and limits on what a page or client may use."""

import io
import json
import re
import socket
import threading
import time
import tracemalloc
from contextlib import closing, contextmanager
from itertools import product
from urllib.parse import urljoin

import numpy as np
import pytest
from PIL import Image
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

import pointray as pr
from helpers.marks import long
from helpers.viewer_client import SECONDS, SIZE, Browser, compile_kernels, scene_of, socket_of
from pointray.viewer import outbox, painter, queries as lookups, session
from pointray.viewer.connection import MAX_WAITING, is_loopback
from pointray.viewer.light_control import MAX_LIGHTS
from pointray.viewer.messages import pack
from pointray.viewer.pace import MOVING, REFINED, STILL
from pointray.viewer.page_limits import CREDIT, SHARE, TRANSPORT, CpuBudget, RateLimiter
from pointray.viewer.painter import IN_FLIGHT, MAX_JPEG_BYTES, encode
from pointray.viewer.server import FILES, Server
from pointray.viewer.session import COSTLY_RATE
from pointray.viewer.shared_scene import SharedScene
from pointray.viewer.view_settings import ViewSettings
from pointray.viewer.viewer import Viewer

BOUND = 16 << 20  # bytes that the server may buffer for one client
HELLO = "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
KEY = "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA=="


@pytest.fixture(scope="module")
def model():
    points = pr.procedural("sphere", 3_000)
    height = points.positions[:, 2].astype(np.float32)
    model = pr.Model(pr.Points(points.positions, points.normals, None, {"height": height}))
    compile_kernels(scene_of(model))
    return model


@pytest.fixture
def scene(model):
    return scene_of(model)


@pytest.fixture
def viewer(scene):
    with closing(Viewer(SharedScene("ball", scene, source="my scans/ball.ply"))) as viewer:
        yield viewer


@pytest.fixture
def browser(viewer):
    with closing(Browser(viewer.url, SIZE)) as browser:
        yield browser


def wait(condition):
    """Wait until a condition holds."""
    end = time.monotonic() + SECONDS
    while not condition():
        assert time.monotonic() < end, "it never happened"
        time.sleep(0.01)


def ask(viewer, target, *headers, host=None):
    """Return the response to an HTTP GET: its status, and all of it as text."""
    host = f"Host: {host or f'127.0.0.1:{viewer.port}'}"
    request = "\r\n".join((f"GET {target} HTTP/1.1", host, *headers, "", ""))
    with socket.create_connection(("127.0.0.1", viewer.port)) as stream:
        stream.settimeout(SECONDS)
        stream.sendall(request.encode("latin-1"))
        answer = b""
        while piece := stream.recv(65536):
            answer += piece
    text = answer.decode(errors="replace")
    return int(text.split(" ")[1]), text


def path_of(viewer):
    """Return the path of the address, which contains the token."""
    return f"/{viewer.url.rstrip('/').rpartition('/')[2]}/"


def test_only_files_of_the_page_are_served(viewer):
    path = path_of(viewer)
    for name in ("../__init__.py", "%2e%2e/server.py", "etc/passwd", "page", "/etc/passwd", "nothing.js"):
        assert ask(viewer, path + name)[0] == 404, name
    assert ask(viewer, path, host="evil.example")[0] == 403
    for name in ("", *FILES):
        status, text = ask(viewer, path + name)
        assert status == 200 and "Content-Security-Policy" in text and "Referrer-Policy: no-referrer" in text, name
    status, text = ask(viewer, path.rstrip("/"))
    assert status == 308 and f"Location: {path.strip('/')}/\r\n" in text  # relative, as there may be a prefix


HUB, PUBLIC = "/user/x/", "hub.example.org"


class Proxy:
    """Forwards requests like jupyter-server-proxy: removes the prefix, keeps Host, and names the prefix."""

    def __init__(self, viewer):
        self.prefix = f"{HUB}proxy/{viewer.port}"
        self.headers = f"X-Forwarded-Context: {self.prefix}", f"X-ProxyContextPath: {self.prefix}"
        self._viewer = viewer

    def get(self, target, *headers):
        """Request an address like the browser."""
        assert target.startswith(f"{self.prefix}/"), target
        return ask(self._viewer, target.removeprefix(self.prefix), *self.headers, *headers, host=PUBLIC)


@pytest.fixture
def hub_viewer(monkeypatch):
    monkeypatch.setenv("JUPYTERHUB_SERVICE_PREFIX", HUB)
    with closing(Viewer(SharedScene("nothing", pr.Scene()))) as viewer:
        yield viewer


@pytest.fixture
def plain_viewer(monkeypatch):
    monkeypatch.delenv("JUPYTERHUB_SERVICE_PREFIX", raising=False)
    with closing(Viewer(SharedScene("nothing", pr.Scene()))) as viewer:
        yield viewer


def test_the_page_works_behind_the_proxy_of_a_hub(hub_viewer):
    """The frame's address and all addresses in it are below the prefix."""
    proxy = Proxy(hub_viewer)
    html = hub_viewer._repr_html_()
    page = re.search(r'src="([^"]+)"', html)[1]
    assert page == f"{proxy.prefix}{path_of(hub_viewer)}" and "jupyter-server-proxy" in html
    status, text = proxy.get(page)
    assert status == 200
    names = re.findall(r'(?:src|href)="([^"]+)"', text)
    assert "main.js" in names
    for name in names:
        if not name.startswith("data:"):
            assert proxy.get(urljoin(page, name))[0] == 200, name
    scripts = [name for name in FILES if name.endswith(".js")]
    for name in scripts:
        for module in re.findall(r'from "([^"]+)"', proxy.get(urljoin(page, name))[1]):
            assert proxy.get(urljoin(urljoin(page, name), module))[0] == 200, module
    status, text = proxy.get(page.rstrip("/"))
    assert urljoin(page.rstrip("/"), re.search(r"Location: (\S+)", text)[1]) == page
    # The script opens the socket next to the page.
    assert 'new URL("socket", location.href' in proxy.get(urljoin(page, "connection.js"))[1]
    hello = f"{HELLO}{KEY}".split("\r\n")
    for origin, answer in ((f"https://{PUBLIC}", 101), ("https://evil.example", 403), ("null", 403)):
        request = (*proxy.headers, *hello, f"Origin: {origin}", "Connection: close")
        assert first_line(hub_viewer, f"{path_of(hub_viewer)}socket", *request)[1] == str(answer), origin


def first_line(viewer, target, *headers):
    """Return the words of the first line of a response; its connection may stay open."""
    with socket.create_connection(("127.0.0.1", viewer.port)) as stream:
        stream.settimeout(SECONDS)
        stream.sendall("\r\n".join((f"GET {target} HTTP/1.1", f"Host: {PUBLIC}", *headers, "", "")).encode())
        return stream.recv(1000).split(b"\r\n")[0].decode().split()  # a first message may follow the header


def test_other_host_names_are_refused_except_for_the_hubs_proxy(hub_viewer, plain_viewer):
    """Other host names are refused without the proxy's header, with another prefix, or without a hub."""
    path, known = path_of(hub_viewer), Proxy(hub_viewer).headers
    assert ask(hub_viewer, path, *known, host=PUBLIC)[0] == 200
    assert ask(hub_viewer, path, host=PUBLIC)[0] == 403
    assert ask(hub_viewer, path, f"X-Forwarded-Context: /user/y/proxy/{hub_viewer.port}", host=PUBLIC)[0] == 403
    assert ask(hub_viewer, "/", *known, host=PUBLIC)[0] == 403  # without the token
    assert ask(plain_viewer, path_of(plain_viewer), *Proxy(plain_viewer).headers, host=PUBLIC)[0] == 403


def test_a_browser_behind_the_proxy_is_remote(hub_viewer):
    seen = []
    hub_viewer._server._make_handler = lambda link: seen.append(link.is_local) or Idle()
    for count, headers in enumerate(({}, dict(header.split(": ") for header in Proxy(hub_viewer).headers)), 1):
        with connect(socket_of(hub_viewer.url), additional_headers=headers):
            wait(lambda count=count: len(seen) == count)
    assert seen == [True, False]


class Idle:
    """A visitor that does nothing."""

    def receive(self, text):
        pass

    def leave(self):
        pass


def test_the_notebook_cell_explains_remote_access(plain_viewer):
    html, port = plain_viewer._repr_html_(), plain_viewer.port
    assert f'src="{plain_viewer.url}"' in html and f"ssh -L {port}:127.0.0.1:{port}" in html


@pytest.mark.parametrize("host", ["127.0.0.1", "0.0.0.0"])
def test_requests_without_the_token_are_refused(scene, host):
    with closing(Viewer(SharedScene("x", scene), host)) as viewer, closing(Viewer(SharedScene("y", scene))) as other:
        token = path_of(viewer).strip("/")
        assert re.fullmatch(r"[\w-]{22}", token) and token != path_of(other).strip("/")
        for wrong in ("", "/", f"/{token[:-1]}/", f"/{token}x/", f"/{token.swapcase()}/", path_of(other)):
            for name in ("", "main.js", "socket", f"?token={token}"):
                assert ask(viewer, wrong + name or "/")[0] == 403, wrong + name
        for origin in (None, f"http://127.0.0.1:{viewer.port}"):
            for wrong in ("", f"{token[:-1]}/", path_of(other).strip("/") + "/"):
                address = f"ws://127.0.0.1:{viewer.port}/{wrong}socket"
                with pytest.raises(InvalidStatus, match="403"), connect(address, origin=origin):
                    pass
            with connect(socket_of(viewer.url), origin=origin):
                pass


def test_malformed_requests_get_client_errors(viewer):
    path, here = path_of(viewer), f"127.0.0.1:{viewer.port}"
    hello = f"{HELLO}{KEY}".split("\r\n")
    requests = [
        *((f"{path}{'a' * length}",) for length in (300, 5_000, 7_900, 20_000)),
        *((f"{path}{'a' * length}.js",) for length in (300, 5_000)),
        *((f"{path}{'a/' * length}",) for length in (200, 3_000)),
        *((f"/{'a' * length}",) for length in (300, 5_000, 20_000)),
        *((f"{path}{name}",) for name in ("\x00", "a\x00.js", "%00")),
        *((target,) for target in ("//[/", "//[::1/", "http://[", f"//[x{path}")),
        *((target, f"Host: {here}") for target in (path, f"{path}socket")),
        *((f"{path}socket", f"Origin: {origin}") for origin in ("http://[", "null", "http://]/")),
        (f"{path}socket", f"Origin: http://{here}", f"Origin: http://{here}", *hello),
        (f"{path}socket", hello[-1], *hello),
        (f"{path}socket", "Upgrade: websocket", *hello),
        (path, *(f"X-{k}: 1" for k in range(200))),
        (path, f"X: {'1' * 20_000}"),
    ]
    for request in requests:
        assert 400 <= ask(viewer, *request)[0] < 500, [part[:60] for part in request]
    for host in ("[", "[::1", "a b", "]", ":::", "\xe9"):
        assert 400 <= ask(viewer, path, host=host)[0] < 500, host
    assert ask(viewer, path)[0] == 200


class Visitor:
    """A session that does nothing."""

    def receive(self, text):
        pass

    def leave(self):
        pass


@contextmanager
def linked():
    """Yield a client of a server, and the server's `Link` to it."""
    links = []
    server = Server(lambda link: (links.append(link), Visitor())[1], "127.0.0.1", 0)
    with closing(server), connect(socket_of(server.url), max_size=None, compression=None, max_queue=1) as client:
        wait(lambda: links)
        yield client, links[0]
        client.close_socket()


@pytest.mark.parametrize(
    ("kind", "size"),
    [
        *product([bytes, str], [1 << 20, MAX_JPEG_BYTES]),
        (bytes, 1_000),
        long(str, 1_000),
        long(bytes, 30),
        long(str, 30),
    ],
)
def test_a_client_that_does_not_read_is_disconnected(kind, size):
    with linked() as (_, link):
        tracemalloc.start()
        begun, sent, held = tracemalloc.get_traced_memory()[0], 0, 0
        while link.open and sent < 100 * BOUND:
            link.send(b"x" * size if kind is bytes else "x" * size)
            sent += max(size, 50)
            held = max(held, tracemalloc.get_traced_memory()[0] - begun)
        assert not link.open and held < BOUND, f"{held:,}"
        wait(lambda: tracemalloc.get_traced_memory()[0] - begun < 1 << 20)  # its memory is freed
        tracemalloc.stop()


@pytest.mark.parametrize(
    "frame",
    [[0x89, 0x80, 0, 0, 0, 0], [0x8A, 0x80, 0, 0, 0, 0], [0x00, 0x80, 0, 0, 0, 0]],
    ids=["pings", "pongs", "empty pieces"],
)
def test_a_client_that_sends_only_pings_or_fragments_is_disconnected(frame):
    """It does not read the answers to its pings, and the fragments of its message do not end."""
    server = Server(lambda link: Visitor(), "127.0.0.1", 0)
    hello = f"GET /{server.token}/socket HTTP/1.1\r\nHost: 127.0.0.1\r\n{HELLO}{KEY}\r\n\r\n"
    first = [0x01, 0x80, 0, 0, 0, 0] if frame[0] == 0 else []
    with closing(server), socket.create_connection(("127.0.0.1", server.port)) as deaf:
        deaf.settimeout(SECONDS)
        deaf.sendall(hello.encode())
        assert b" 101 " in deaf.recv(4096)
        deaf.sendall(bytes(first))
        tracemalloc.start()
        with pytest.raises(ConnectionError):
            server._loop.call_soon_threadsafe(time.sleep, 0.2)  # then all pending data is read at once
            for _ in range(1_000):  # more than the system buffers before the server reads
                deaf.sendall(bytes(frame) * 50_000)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < BOUND // 8, f"{peak:,}"


def test_a_file_of_any_size_goes_to_a_client_that_reads(tmp_path, rng):
    contents = rng.bytes(3 * BOUND)
    (tmp_path / "big.exr").write_bytes(contents)
    with linked() as (client, link):
        sending = threading.Thread(target=link.send_file, args=(pack({"type": "file"}), tmp_path / "big.exr"))
        sending.start()
        wait(lambda: link._sending)
        link.send("after it")
        received, after = client.recv(), client.recv()
        assert received[4 + received[0] :] == contents and after == "after it"
        sending.join(SECONDS)
        assert not sending.is_alive() and link.open


@pytest.mark.parametrize("sent", [0, 2])
def test_sending_a_file_stops_when_the_client_disconnects(tmp_path, sent):
    (tmp_path / "big.exr").write_bytes(bytes(3 * BOUND))
    with linked() as (client, link):
        for _ in range(sent):
            link.send(bytes(BOUND // 4))
        tracemalloc.start()
        sending = threading.Thread(target=link.send_file, args=(b"", tmp_path / "big.exr"))
        sending.start()
        wait(lambda: link._sending)
        sending.join(0.1)
        assert sending.is_alive()  # the thread waits for the client, with the file on the disk
        assert tracemalloc.get_traced_memory()[1] < BOUND // 4
        tracemalloc.stop()
        client.close_socket()
        sending.join(SECONDS)
        assert not sending.is_alive() and not link.open
        link.send_file(b"", tmp_path / "big.exr")  # no client is left, so it returns at once
        with pytest.raises(OSError):
            link.send_file(b"", tmp_path / "none.exr")


@pytest.mark.parametrize("side", [480, long(3840)])
def test_pictures_in_flight_fit_into_what_may_wait(side, rng, monkeypatch):
    """The worst picture of 3840x3840 pixels, or a part of it that may have as many bytes a pixel."""
    noise, most = rng.integers(0, 256, (side, side, 3), dtype=np.uint8), MAX_JPEG_BYTES * side**2 // 3840**2
    monkeypatch.setattr(painter, "MAX_JPEG_BYTES", most)
    assert len(encode(noise, REFINED)) <= most and IN_FLIGHT * MAX_JPEG_BYTES < MAX_WAITING - (2 << 20)
    calm = np.zeros((480, 640, 3), np.uint8)
    assert encode(calm, REFINED) != encode(calm, REFINED._replace(quality=75))


def test_small_moving_pictures_keep_their_colours():
    """A red and blue checkerboard of single pixels, which the page magnifies: subsampled chroma would be purple."""
    board = np.indices((120, 160)).sum(axis=0)[..., None] % 2
    small = np.where(board, [200, 20, 20], [20, 20, 200]).astype(np.uint8)
    shown = np.asarray(Image.open(io.BytesIO(encode(small, MOVING)))).astype(int)
    assert np.abs(shown - small).mean() < 8
    large = np.tile(small, (5, 5, 1))
    assert encode(large, MOVING) != encode(large, STILL)


class Deaf:
    """A `link.Link` to nobody, from any address, which records its messages."""

    def __init__(self, is_local):
        self.is_local, self.said = is_local, []

    def send(self, message):
        if isinstance(message, str):
            self.said.append(json.loads(message))


@pytest.mark.parametrize(("is_local", "source"), [(True, "'/home/me/my scans/ball.ply'"), (False, "ball.ply")])
def test_remote_pages_receive_no_paths(scene, is_local, source):
    link, shared = Deaf(is_local), SharedScene("ball.ply", scene, source="/home/me/my scans/ball.ply")
    page = session.Session(link, shared, lambda _: None)
    page.receive(json.dumps({"type": "size", "width": 64, "height": 48}))
    page.receive(json.dumps({"type": "press", "name": "copy.command"}))
    shared.problem = "/home/me/my scans/ball.ply: damaged"
    shared.notify()
    wait(lambda: any(m["type"] == "toast" for m in link.said))
    page.leave()
    texts = {m["type"]: m["text"] for m in link.said if m["type"] in ("copy", "toast")}
    assert texts["copy"].startswith(f"pointray render {source} -o picture.png ")
    assert texts["toast"] == ("/home/me/my scans/ball.ply: damaged" if is_local else "ball.ply: damaged")
    assert ("/home" in json.dumps(link.said)) == is_local


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[Errno 2] No such file or directory: '/home/me/a b/x.ply'", "[Errno 2] No such file or directory: 'x.ply'"),
        ("scans/x.ply: line 3: it is cut", "x.ply: line 3: it is cut"),
        (r"cannot read C:\Users\me\x.ply: damaged", "cannot read x.ply: damaged"),
        ("~/scans/../x.ply is damaged", "x.ply is damaged"),
        ("nothing / here: 3 / 4", "nothing / here: 3 / 4"),
    ],
)
def test_folders_are_removed_from_texts(text, expected):
    assert outbox.FOLDERS.sub("", text) == expected


@pytest.mark.parametrize("host", ["localhost", "127.0.0.1", "127.3.2.1", "::1", "::ffff:127.0.0.1"])
def test_local_addresses_are_recognised(host):
    assert is_loopback(host)
    assert not any(map(is_loopback, ("0.0.0.0", "192.0.2.1", "::", "::ffff:192.0.2.1", "fe80::1%eth0", "a.example")))


@pytest.mark.long
def test_too_many_lights_are_refused_with_a_message(browser, viewer, scene):
    other = Browser(viewer.url, SIZE)
    camera = other.arrive()
    browser.arrive()
    begun = time.monotonic()
    for _ in range(1_000):
        browser.say(type="press", name="lamps.add.sun")
    # Another page is served meanwhile.
    for k in range(5):
        count = len(other.frames)
        other.go(camera, fov=30.0 + k, time=2.0 + k)
        other.listen(lambda n=count, k=k: any(h["time"] == 2.0 + k for h, _ in other.frames[n:]))
    browser.say(type="sun", dx=0.1, dy=0.0)  # the last one that is answered
    browser.listen(lambda: browser.last("values"))
    lamps = [name for name in browser.controls() if re.fullmatch(r"lamps\.\d+\.on", name)]
    assert len(lamps) == MAX_LIGHTS
    output = [m["text"] for m in browser.told if m["type"] == "toast"]
    assert f"there are {MAX_LIGHTS} lights: remove one to add another" in output
    assert "too many requests at once: some were ignored" in output
    assert len(output) <= 2 * (1 + (time.monotonic() - begun) / outbox.REPEAT_INTERVAL)  # each is repeated at intervals
    assert sum(m["type"] == "panel" for m in browser.told) <= MAX_LIGHTS + 2
    browser.rest(1.5 / COSTLY_RATE)  # from then on requests are accepted again
    browser.set("lamps.0.on", False)
    browser.say(type="press", name="lamps.1.remove")
    browser.listen(lambda: f"lamps.{MAX_LIGHTS - 1}.on" not in browser.controls())
    other.close()


def test_ctrl_drag_adds_no_light_beyond_the_limit(browser, scene):
    scene.lights = [pr.PointLight([9, 9, 9], 1)] * MAX_LIGHTS
    browser.arrive()
    browser.listen(lambda: f"lamps.{MAX_LIGHTS - 1}.on" in browser.controls())
    browser.say(type="sun", dx=0.1, dy=0.0)
    assert "remove one to add another" in browser.listen(lambda: browser.last("toast"))["text"]


def test_a_scene_of_many_lights_has_a_panel(browser, scene):
    scene.lights = [pr.PointLight([9, 9, k], 1) for k in range(MAX_LIGHTS + 5)]
    browser.arrive()
    browser.listen(lambda: "more_lamps" in browser.controls())
    assert browser.controls()["more_lamps"]["value"].startswith("And 5 more")
    assert f"lamps.{MAX_LIGHTS}.on" not in browser.controls()


def test_work_for_one_page_does_not_block_another(browser, viewer, scene, monkeypatch):
    """The work takes any time, here until the other page has its pictures."""
    busy, go, whole = threading.Event(), threading.Event(), ViewSettings.with_lamp

    def slow(self, *arguments):
        busy.set()
        assert go.wait(2 * SECONDS)
        return whole(self, *arguments)

    monkeypatch.setattr(ViewSettings, "with_lamp", slow)
    browser.arrive()
    browser.say(type="press", name="lamps.add.sun")
    assert busy.wait(SECONDS)
    try:
        with closing(Browser(viewer.url, SIZE)) as other:  # a request during the work
            camera = other.arrive()
            other.go(camera, fov=30.0, time=2.0)
            other.listen(lambda: any(header["time"] == 2.0 for header, _ in other.frames))
            scene.lights = []  # all pages are notified, the busy one too
            other.listen(lambda: "no_lamps" in other.controls())
        assert "lamps.0.on" in browser.controls()
    finally:
        go.set()
    browser.listen(lambda: "no_lamps" in browser.controls())


def test_of_many_requested_legends_the_newest_is_drawn(browser, monkeypatch):
    """The server reads messages while a legend is drawn, and skips all but the newest."""
    busy, go, drawn = threading.Event(), threading.Event(), []
    whole = lookups.legend_of

    def slow(attribute):
        drawn.append(attribute.colormap)
        busy.set()
        assert go.wait(SECONDS)
        return whole(attribute)

    browser.arrive()
    monkeypatch.setattr(lookups, "legend_of", slow)
    browser.set("color_by", "height")
    assert busy.wait(SECONDS)
    for name in ("plasma", "magma") * 10:
        browser.set("colormap", name)
    before = browser.last("camera")
    browser.say(type="view", name="front")  # answered after all of them are read
    browser.listen(lambda: browser.last("camera") is not before)
    go.set()
    browser.listen(lambda: (m := browser.last("legend")) and m["image"])
    assert drawn[:2] == ["viridis", "magma"] and len(drawn) <= 3  # and once more for the range that was found


def test_many_surface_changes_need_two_threads(scene):
    shared = SharedScene("x", scene)
    with shared._builds:  # pretends that one is being built
        threads = {shared.rebuild(radius_scale=1.0 + k / 1_000) for k in range(1, 500)}
        assert len(threads) == 1
    for thread in threads:
        thread.join()
    assert shared.build.radius_scale == 1.499


def test_the_rate_of_requests_is_limited():
    now = [0.0]
    allowance = RateLimiter(COSTLY_RATE, 2 * COSTLY_RATE, lambda: now[0])
    assert sum(allowance.take() for _ in range(2_000)) == 2 * COSTLY_RATE
    now[0] += 1.0
    assert sum(allowance.take() for _ in range(2_000)) == COSTLY_RATE
    now[0] += 100.0
    assert sum(allowance.take() for _ in range(2_000)) == 2 * COSTLY_RATE
    share, worked = CpuBudget(lambda: now[0]), 0.0
    begun = now[0]
    while now[0] < begun + 60:
        worked += 0.02
        now[0] += 0.02 + share.rest(0.02 - TRANSPORT)
    assert worked == pytest.approx(60 * SHARE, rel=0.05)
    now[0] += 10.0
    assert share.rest(CREDIT - TRANSPORT) == 0.0
