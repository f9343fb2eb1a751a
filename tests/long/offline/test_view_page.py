"""The page of `fsw view` in Chromium: no error, the right poses, and what was known at a time."""

import base64
import io
import json
import re
import time

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from fsw.__main__ import main
from planner import spline
from tests.support.browser import ARTIFACTS, PATIENCE_S, chromium, console_errors

Y_UP = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1.0]])  # the viewer's own
POSE = """
window.motion.seek(arguments[0]);
const tree = window.motion.viewer.scene_tree;
const node = tree.find(arguments[1].split('/').filter((word) => word)).object;
tree.object.updateMatrixWorld(true);
return node.matrixWorld.elements;
"""
PANE = "const r = document.getElementById('room').getBoundingClientRect(); return [r.top, r.bottom]"
SHOWN = """
return [document.documentElement.scrollWidth, document.getElementById('now').textContent,
        document.getElementById('pane').querySelector('canvas').clientWidth];
"""


def planned(arm, folder):
    """Return the page of a motion of the small arm."""
    points = np.vstack([np.zeros((4, 3)), [[0.5, -0.8, 0.4], [1.0, 0.3, -0.9]], *[[[0.2] * 3]] * 4])
    spline.save(spline.Trajectory(duration_s=12.0, points_rad=points), folder / "plan.yaml", {})
    truth = folder / "truth.json"
    truth.write_text(json.dumps({"target": {"mass_kg": 70.0, "com_m": [0.0, 0.1, 0.5]}}))
    out = folder / "plan.html"
    arguments = ["--config", str(arm.write()), "--truth", str(truth), "--out", str(out)]
    assert main(["view", str(folder / "plan.yaml"), *arguments]) == 0
    return out


def matrix(frame, k):
    """Return the pose that the file has at its instant k."""
    X = np.eye(4)
    X[:3, :3] = Rotation.from_quat(frame["q"][4 * k : 4 * k + 4]).as_matrix()
    X[:3, 3] = frame["p"][3 * k : 3 * k + 3]
    return X


def assert_legible(picture: bytes, top: float, bottom: float) -> None:
    """Estimate, truth and what moves are large enough to see in the picture of a page."""
    shown = np.asarray(Image.open(io.BytesIO(picture)).convert("RGB")).astype(int)
    shown = shown[int(top) + 30 : int(bottom)]  # without the text, and the head of the panel
    counts = {
        name: np.count_nonzero(np.abs(shown - colour).max(axis=2) <= 3)
        for name, colour in (("estimate", (0x1F, 0x5F, 0xA8)), ("truth", (0xC4, 0x51, 0x1D)))
    }
    assert min(counts.values()) >= 12, counts
    drawn = np.argwhere(shown.min(axis=2) < 250)
    high, wide = (drawn.max(axis=0) - drawn.min(axis=0)) / shown.shape[:2]
    assert max(high, wide) > 0.5


def until_drawn(browser) -> None:
    """Wait for the first picture."""
    deadline = time.monotonic() + PATIENCE_S
    while not browser.execute_script("return document.getElementById('now')?.textContent"):
        assert time.monotonic() < deadline, console_errors(browser)
        time.sleep(0.1)


def test_the_scene_moves_as_the_file_says_without_error(arm, tmp_path):
    path = planned(arm, tmp_path)
    inside = re.search(r'type="application/json">(.*?)</script>', path.read_text(), re.S)
    assert inside is not None
    scene = json.loads(inside[1])
    with chromium(tmp_path / "profile") as browser:
        for width in (1400, 390):
            size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
            browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
            browser.get(path.as_uri())
            until_drawn(browser)
            for frame in scene["frames"]:
                for k in (1, len(frame["t"]) // 2, len(frame["t"]) - 2):
                    found = browser.execute_script(POSE, frame["t"][k], frame["path"])
                    shown = Y_UP.T @ np.array(found).reshape(4, 4).T
                    assert shown == pytest.approx(matrix(frame, k), abs=1e-5), "single precision"
            wide, text, canvas = browser.execute_script(SHOWN)
            assert wide <= width
            assert canvas == width
            assert "target: 80 \u00b1 40 kg" in text
            assert "true size; truth 70 kg, 0.17 m from the estimate" in text
            shot = browser.execute_cdp_cmd("Page.captureScreenshot", {})
            ARTIFACTS.mkdir(parents=True, exist_ok=True)
            picture = base64.b64decode(shot["data"])
            (ARTIFACTS / f"view_{width}.png").write_bytes(picture)
            assert_legible(picture, *browser.execute_script(PANE))
        assert console_errors(browser) == []
