"""The page in a real browser, wide and as narrow as a phone, by mouse and by keyboard.

Needs `pip install playwright` and Debian's chromium; where one of them is missing, the tests are skipped.
"""

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import trimesh

sync_api = pytest.importorskip("playwright.sync_api", reason="pip install playwright")
CHROMIUM = shutil.which("chromium")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no chromium here")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("app")
    trimesh.creation.box((1.2, 0.8, 0.3)).export(root / "step.stl")
    return root


@pytest.fixture(scope="module")
def address(folder: Path) -> Iterator[str]:
    command = [sys.executable, "-m", "realsim", "app", str(folder), "--no-open"]
    root = Path(__file__).resolve().parents[2]
    environment = {**os.environ, "PYTHONPATH": str(root), "PYTHONUNBUFFERED": "1"}
    environment.pop("PYTEST_CURRENT_TEST", None)  # NiceGUI takes it for its own tests
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)
    assert process.stdout is not None
    found = re.search(r"http://\S+", process.stdout.readline())
    assert found is not None
    yield found[0]
    process.terminate()
    process.wait(20)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with sync_api.sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", "--disable-gpu"])
        yield chromium
        chromium.close()


def visit(browser: Any, address: str, width: int) -> Any:
    page = browser.new_page(viewport={"width": width, "height": 844})
    for attempt in range(40):  # the server prints its address before it listens
        try:
            page.goto(address)
            break
        except sync_api.Error:
            if attempt == 39:
                raise
            page.wait_for_timeout(500)
    page.get_by_text("What do you have?").wait_for()
    return page


@pytest.mark.parametrize("width", [1280, 390])
def test_nothing_is_wider_than_the_page(browser: Any, address: str, width: int) -> None:
    page = visit(browser, address, width)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert "token" not in page.url


def test_from_a_mesh_to_its_report_by_keyboard_alone(browser: Any, address: str, folder: Path) -> None:
    page = visit(browser, address, 1280)
    page.wait_for_timeout(1000)
    page.keyboard.type("step.stl")
    page.keyboard.press("Enter")
    start = page.get_by_role("button", name="Make collision geometry")
    start.wait_for(timeout=120_000)
    for _ in range(40):
        page.keyboard.press("Tab")
        if "make collision geometry" in (page.evaluate("document.activeElement.innerText") or "").lower():
            break
    else:
        pytest.fail("the button cannot be reached with Tab")
    page.keyboard.press("Enter")
    report = page.get_by_role("button", name="Report").first
    report.wait_for(timeout=240_000)
    report.focus()
    page.keyboard.press("Enter")
    frame = page.frame_locator('iframe[title="report"]')
    frame.get_by_text("Contact of step.stl").wait_for()
    assert (folder / "step_contact" / "scene.xml").is_file()


def test_a_button_stays_the_same_while_a_command_runs(browser: Any, address: str) -> None:
    page = visit(browser, address, 1280)
    page.get_by_label("path below the folder").fill("step.stl")
    page.get_by_role("button", name="Open").click()
    page.get_by_role("button", name="Make collision geometry").click(timeout=120_000)
    page.get_by_role("button", name="Stop").focus()
    page.wait_for_timeout(1200)
    assert "stop" in page.evaluate("document.activeElement.innerText").lower()
    page.keyboard.press("Enter")
    page.get_by_text("cancelled").wait_for()


def test_a_wrong_path_says_what_is_wrong(browser: Any, address: str) -> None:
    page = visit(browser, address, 390)
    page.get_by_label("path below the folder").fill("../../etc")
    page.get_by_role("button", name="Open").click()
    page.get_by_text("leads out of the folders").wait_for()
    page.get_by_label("path below the folder").fill("step.stl")
    page.get_by_role("button", name="Open").click()
    page.get_by_text("leads out of the folders").wait_for(state="hidden", timeout=60_000)
