"""Curves of the live page: what was moved along with time is what would be drawn again."""

from __future__ import annotations

from pathlib import Path

import pytest

import gateway.live
from tests.support.pages.browser import MISSING, available, browser

pytestmark = pytest.mark.skipif(not available(), reason=MISSING)

CHARTS = Path(gateway.live.__file__).parent / "static" / "charts.js"
PAGE = """<!doctype html><meta charset=utf-8>
<style>:root {{ --muted: #5a6675; --grid: #e6eaef; --paper: #ffffff; --torque: #0a63c2; }}
.chart {{ width: 420px }}</style>
<div id=place></div><script>{script}</script>"""
#: Shares of the pixels that differ from the paper: moved along for 14 s at 60 Hz, and drawn again.
INKED = """
const strip = new Strip(document.querySelector("#place"), "torque", "Nm", ["--torque"]);
const time = [], values = [];
for (let k = 0; k < 25 * 60; k++) {
  time.push(k / 60); values.push(k < 2 ? 20 * k - 10 : 5 * Math.sin(k / 90));
  if (k > 11 * 60) strip.show(time, [values]);
}
const inked = () => {
  const { canvas, pen } = strip;
  const data = pen.getImageData(0, 0, canvas.width, canvas.height).data;
  let count = 0;
  for (let at = 0; at < data.length; at += 4) count += data[at] < 250;
  return count / (data.length / 4);
};
const moved = inked();
strip.stale = true;
strip.draw();
return [moved, inked()];
"""


def test_curves_that_move_along_leave_nothing_behind(tmp_path: Path) -> None:
    page = tmp_path / "curves.html"
    page.write_text(PAGE.format(script=CHARTS.read_text(encoding="utf-8")), encoding="utf-8")
    with browser() as window:
        window.open(page)
        moved, again = window.run(INKED)
    assert 0.02 < again < 0.2
    assert moved == pytest.approx(again, rel=0.1)
