import time
from playwright.sync_api import expect
from .test_lab import RUN_MS, write
MAKE = """
%matplotlib inline
import numpy as np, time
from mmqa_lab import widgets
from mmqa_lab.cloud import Cloud
rng = np.random.default_rng(0)
def flat(n, a, b, axis, value):
    p = rng.uniform(0, 1, (n, 3)) * [a, a, b]; p[:, axis] = value
    return p
points = np.concatenate([flat(810_000, 9, 9, 1, 0), rng.uniform(0, 1, (500_000, 3)) * [9, 9, 0], flat(190_000, 9, 9, 0, 0)])
points += rng.normal(0, 0.004, points.shape) + [500_000, 5_300_000, 200]
print("made")
"""
TOOL = """
t0 = time.perf_counter()
tool = widgets.SurfaceTool({"street": Cloud(points)}, size=1, detail=0.1)
print("constructed", round(time.perf_counter() - t0, 2))
tool
"""
SELECTED = """
@tool.follow
def show(tool):
    print(f"shown: {tool.planes['kind'][tool.number]}, {tool.quality.n} points, {time.perf_counter() - t0:.2f} s, {tool.quality.density_polygon_per_m2:.0f}")
"""
def test_time(browser, ran, lab_folder):
    write(lab_folder, "big.ipynb", MAKE, TOOL, SELECTED)
    t=time.time(); page = ran("big")
    made = page.locator("pre", has_text="made").last
    expect(made).to_be_visible(timeout=RUN_MS); a=time.time()
    shown = page.locator("pre", has_text="shown: ").last
    expect(shown).to_be_visible(timeout=RUN_MS); b=time.time()
    img = page.locator(".jp-OutputArea-output canvas, .jp-OutputArea-output img").first
    print("first picture after made", round(b-a,2), img.count(), page.locator("pre", has_text="constructed").inner_text())
    planes = page.get_by_label("plane", exact=True)
    for _ in range(6):
        before = shown.inner_text()
        planes.focus(); t=time.time()
        page.keyboard.press("ArrowDown" if _ % 2 == 0 else "ArrowUp")
        for k in range(3):
            try:
                expect(shown).not_to_have_text(before, timeout=8000)
            except AssertionError: break
            before=shown.inner_text(); print(f"{time.time()-t:.2f} s: {before}")
    page.screenshot(path="/tmp/tests/big.png", full_page=True)
