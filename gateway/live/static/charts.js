// Curves over the last seconds, and points pose by pose; uPlot draws, this says what of.
"use strict";

const WINDOW_S = 20;
const HEIGHT_PX = 132;

function css(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

function jointColour(joint) {
  return css(`--j${((joint - 1) % 8) + 1}`);
}

class Chart {
  // names: colours of the series as CSS variables; x: "time" or "pose"; unit stands at the axis
  constructor(place, title, unit, colours, x) {
    this.frame = document.createElement("div");
    this.frame.className = "chart";
    this.frame.innerHTML = "<b></b> <span class=unit></span><div></div>";
    this.frame.querySelector("b").textContent = title;
    this.frame.querySelector(".unit").textContent = `[${unit}] over ${x === "time" ? "time [s]" : "poses as measured"}`;
    place.append(this.frame);
    this.colours = colours;
    this.x = x;
    this.data = [[], ...colours.map(() => [])];
    this.make();
  }

  make() {
    if (this.plot) this.plot.destroy();
    const points = this.x === "pose";
    const axis = { stroke: css("--muted"), grid: { stroke: css("--grid"), width: 1 }, ticks: { show: false }, font: "11px sans-serif" };
    this.plot = new uPlot(
      {
        width: this.frame.clientWidth || 360,
        height: HEIGHT_PX,
        legend: { show: false },
        cursor: { show: false },
        select: { show: false },
        scales: {
          x: { time: false, range: (_u, low, high) => (points ? [0.5, Math.max(high ?? 1, 4) + 0.5] : [Math.max(low ?? 0, (high ?? 1) - WINDOW_S), Math.max(high ?? 1, (low ?? 0) + 1)]) },
          y: { range: (_u, low, high) => room(low, high) },
        },
        axes: [
          { ...axis, size: 22, space: 60, incrs: points ? [1, 2, 5, 10, 20, 50] : undefined },
          { ...axis, size: 48, space: 24, values: (_u, ticks) => ticks.map((tick) => String(+tick.toPrecision(4))) },
        ],
        series: [
          {},
          ...this.colours.map((name) => ({
            stroke: css(name),
            width: points ? 0 : 1.4,
            paths: points ? () => null : undefined,
            points: { show: points, size: 6, fill: css(name) },
            spanGaps: false,
          })),
        ],
      },
      this.data,
      this.frame.lastElementChild,
    );
  }

  resize() {
    const width = this.frame.clientWidth;
    if (width && width !== this.plot.width) this.plot.setSize({ width, height: HEIGHT_PX });
  }

  show(data) {
    this.data = data;
    this.plot.setData(data);
  }
}

// Some room above and below, and never a range so small that noise fills it.
function room(low, high) {
  if (low == null || high == null) return [-1, 1];
  const pad = Math.max(0.08 * (high - low), 0.02 * Math.max(Math.abs(low), Math.abs(high)), 1e-3);
  return [low - pad, high + pad];
}
