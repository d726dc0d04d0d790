"""JupyterLab on copies of the study notebooks, driven by Chromium."""

import json
import os
import shutil
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request

import pytest

BROWSERS = ("chromium", "chromium-browser", "google-chrome")

ARGUMENTS = (
    *("--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
    *("--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
)
"""Runs as root, calls nobody, draws WebGL in software."""

RUN_S = 120
"""Until the kernel of a notebook answers, on a machine that may be busy."""

CONNECTED = """() => {
    const context = window.jupyterapp?.shell.currentWidget?.sessionContext;
    return context?.isReady && context.session?.kernel?.connectionStatus === "connected";
}"""

RUN_ALL = "() => jupyterapp.commands.execute('notebook:run-all-cells').then(() => true)"
"""What the menu runs; before the kernel answers, it would ask for one at every cell."""

SETTINGS = {
    "notebook-extension/tracker": {"windowingMode": "none"},
    "apputils-extension/notification": {"fetchNews": "false"},
}
"""All cells stay in the page; no news pop up."""


def pytest_collection_modifyitems(items):
    """Mark the tests of this folder, and skip them with the reason where they cannot run."""
    reason = _missing()
    for item in items:
        if "tests/browser" in item.path.as_posix():
            item.add_marker(pytest.mark.browser)
            item.add_marker(pytest.mark.timeout(1800))
            if reason:
                item.add_marker(pytest.mark.skip(reason=reason))


def _missing():
    """What a browser test needs and does not find, empty when nothing is missing."""
    if executable() is None:
        return f"needs Chromium: none of {', '.join(BROWSERS)} is installed"
    try:
        import playwright  # noqa: F401
    except ImportError:
        return "needs the Python package playwright"
    return ""


def executable():
    """Path of the browser, or None."""
    return next(filter(None, map(shutil.which, BROWSERS)), None)


@pytest.fixture(scope="session")
def browser():
    """Chromium without a screen."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        chromium = driver.chromium.launch(executable_path=executable(), args=ARGUMENTS)
        yield chromium
        chromium.close()


@pytest.fixture(scope="session")
def lab_folder(tmp_path_factory):
    """The folder that JupyterLab serves."""
    folder = tmp_path_factory.mktemp("lab") / "notebooks"
    folder.mkdir()
    return folder


@pytest.fixture(scope="session")
def lab(lab_folder):
    """JupyterLab that serves the folder; its address."""
    folder = lab_folder.parent
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    options = (
        *("--allow-root", "--no-browser", "--ip=127.0.0.1", f"--port={port}"),
        *("--IdentityProvider.token=", f"--ServerApp.root_dir={lab_folder}"),
        "--expose-app-in-browser",
    )
    log = folder / "server.log"
    with log.open("w") as said:
        server = subprocess.Popen(
            [sys.executable, "-m", "jupyterlab", *options],
            env=_environment(folder),
            stdout=said,
            stderr=subprocess.STDOUT,
        )
        try:
            _wait(server, f"http://127.0.0.1:{port}/api/status", log)
            yield f"http://127.0.0.1:{port}"
        finally:
            server.terminate()
            server.wait(30)


def _environment(folder):
    """The variables of a person at a screen, with settings and results in a folder of their own."""
    environment = {**os.environ, "MMQA_RESULTS": str(folder / "results")}
    for name in ("JUPYTER_CONFIG_DIR", "JUPYTERLAB_SETTINGS_DIR", "JUPYTERLAB_WORKSPACES_DIR"):
        environment[name] = str(folder / name.lower())
    environment["JUPYTER_RUNTIME_DIR"] = str(folder / "runtime")
    for name, settings in SETTINGS.items():
        file = folder / "jupyterlab_settings_dir" / "@jupyterlab" / f"{name}.jupyterlab-settings"
        file.parent.mkdir(parents=True)
        file.write_text(json.dumps(settings))
    for name in ("MMQA_HEADLESS", "MPLBACKEND", "MMQA_DATA", "DISPLAY"):
        environment.pop(name, None)
    return environment


def _wait(server, address, log, seconds=300):
    """Return when the server answers."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        if server.poll() is not None:
            break
        try:
            urllib.request.urlopen(address, timeout=2)
            return
        except (urllib.error.URLError, TimeoutError, ConnectionError):
            time.sleep(0.25)
    raise RuntimeError(f"JupyterLab did not start: {log.read_text()[-2000:]}")


GRAVE = ("serious", "critical")


@pytest.fixture
def barriers():
    """What axe-core finds in a part of a page, of the graver kinds, one line each."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="needs axe-core")

    def found(page, part="body"):
        """Rule and first place of each finding."""
        said = axe.Axe().run(page, context=part).response["violations"]
        return [f"{one['id']}: {one['nodes'][0]['html']}" for one in said if one["impact"] in GRAVE]

    return found


@pytest.fixture
def ran(browser, lab, tmp_path):
    """Open a notebook, run it to the end; returns the page. A failing test leaves a screenshot."""
    page = browser.new_page(viewport={"width": 1400, "height": 1000})

    def run(name):
        """The page of a notebook whose cells have all run."""
        page.goto(f"{lab}/lab/tree/{name}.ipynb?reset")
        page.wait_for_function(CONNECTED, timeout=1000 * RUN_S)
        page.evaluate(RUN_ALL)
        return page

    yield run
    page.screenshot(path=tmp_path / "last.png")
    page.close()
