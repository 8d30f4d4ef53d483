// Curves over the last seconds, of which only what is new is drawn, and points pose by pose.
// A computer without a graphics card draws every pixel itself: a curve of 20 s that is drawn again with each frame costs
// it more than all the rest of the page. What is there moves to the left by whole pixels, and its end is added.
"use strict";

const WINDOW_S = 20;
const HEIGHT_PX = 132;
const LEFT_PX = 48, BOTTOM_PX = 20, TOP_PX = 4;
// Between two lines of the grid at least.
const GRID_PX = 24, TICK_S = 5;
// A curve that needs less than this share of its axis is given a narrower one.
const NARROWER = 0.55;
// How often it is looked whether the axis may become narrower.
const LOOK_S = 1;

function css(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

class Plot {
  // colours: of the series, as CSS variables
  constructor(place, title, what, colours) {
    this.frame = document.createElement("div");
    this.frame.className = "chart";
    this.frame.innerHTML = "<b></b> <span class=unit></span><canvas></canvas>";
    this.frame.querySelector("b").textContent = title;
    this.frame.querySelector(".unit").textContent = what;
    this.canvas = this.frame.querySelector("canvas");
    place.append(this.frame);
    this.names = colours;
    this.series = colours.map(() => []);
    this.restyle();
    this.resize();
  }

  restyle() {
    this.colours = this.names.map(css);
    this.ink = css("--muted");
    this.grid = css("--grid");
    this.paper = css("--paper");
    this.stale = true;
  }

  // Measured here alone: asking a page for a width while it changes has it laid out at once.
  resize() {
    this.ratio = window.devicePixelRatio || 1;
    this.canvas.width = Math.round((this.frame.clientWidth || 360) * this.ratio);
    this.canvas.height = Math.round(HEIGHT_PX * this.ratio);
    // whole pixels on the screen as well: one that is stretched by a third of a pixel is blurred
    this.canvas.style.width = `${this.canvas.width / this.ratio}px`;
    // no pixel may let through what was there before it: curves are moved on top of themselves
    this.pen = this.canvas.getContext("2d", { alpha: false });
    this.left = Math.round(LEFT_PX * this.ratio);
    this.top = Math.round(TOP_PX * this.ratio);
    this.base = this.canvas.height - Math.round(BOTTOM_PX * this.ratio);
    this.stale = true;
  }

  range(low, high) {
    [this.low, this.high] = withMargin(low, high);
    this.slope = (this.base - this.top) / (this.high - this.low);
    const step = nice((this.high - this.low) * (GRID_PX * this.ratio) / (this.base - this.top));
    this.ticks = [];
    for (let at = Math.ceil(this.low / step); at * step <= this.high; at++) this.ticks.push(at * step);
  }

  y(value) {
    return this.base - (value - this.low) * this.slope;
  }

  // Everything but curves and points.
  blank() {
    const { pen, canvas } = this;
    pen.fillStyle = this.paper;
    pen.fillRect(0, 0, canvas.width, canvas.height);
    pen.font = `${11 * this.ratio}px sans-serif`;
    pen.fillStyle = this.ink;
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    for (const tick of this.ticks) pen.fillText(String(+tick.toPrecision(4)), this.left - 6 * this.ratio, this.y(tick));
    this.lines(this.left, canvas.width);
  }

  lines(from, to) {
    this.pen.fillStyle = this.grid;
    for (const tick of this.ticks) this.pen.fillRect(from, Math.round(this.y(tick)), to - from, Math.max(1, Math.round(this.ratio)));
  }

  upright(x, text) {
    const { pen } = this;
    pen.fillStyle = this.grid;
    pen.fillRect(Math.round(x), this.top, Math.max(1, Math.round(this.ratio)), this.base - this.top);
    pen.fillStyle = this.ink;
    pen.textAlign = "center";
    pen.textBaseline = "alphabetic";
    pen.fillText(text, x, this.canvas.height - 5 * this.ratio);
  }
}

class Strip extends Plot {
  constructor(place, title, unit, colours, scale = 1) {
    super(place, title, `[${unit}] over time [s]`, colours);
    this.scale = scale;
    this.time = [];
    this.last_s = null;
    this.looked_s = 0;
  }

  // series: values of every instant in `time`, null where there is none
  show(time, series) {
    this.time = time;
    this.series = series;
    this.draw();
  }

  draw() {
    const count = this.time.length;
    if (!count) return;
    const newest_s = this.time[count - 1], from = this.first_new();
    if (newest_s === this.last_s && !this.stale) return;
    if (this.stale || this.last_s === null || newest_s < this.last_s || newest_s - this.last_s > WINDOW_S / 2 || !this.holds(from)) this.whole(newest_s);
    else this.more(newest_s, from);
    this.last_s = newest_s;
  }

  // Place of the last sample that is drawn already.
  first_new() {
    let at = this.time.length - 1;
    while (at > 0 && this.time[at] > this.last_s) at--;
    return at;
  }

  // Whether the axis holds what is new, and once in a while, whether all that is shown needs it.
  holds(from) {
    const newest_s = this.time[this.time.length - 1];
    const [low, high] = this.span(from);
    if (low != null && (low < this.low || high > this.high)) return false;
    if (newest_s - this.looked_s < LOOK_S) return true;
    this.looked_s = newest_s;
    const wanted = withMargin(...this.span(this.first_shown(newest_s)));
    return wanted[1] - wanted[0] > NARROWER * (this.high - this.low);
  }

  span(from) {
    let low = null, high = null;
    for (const values of this.series)
      for (let at = from; at < values.length; at++) {
        const value = values[at];
        if (value === null) continue;
        if (low === null || value < low) low = value;
        if (high === null || value > high) high = value;
      }
    return low === null ? [null, null] : [low * this.scale, high * this.scale];
  }

  first_shown(newest_s) {
    let low = 0, high = this.time.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.time[middle] < newest_s - WINDOW_S) low = middle + 1;
      else high = middle;
    }
    return Math.max(0, low - 1);
  }

  whole(newest_s) {
    const from = this.first_shown(newest_s), { pen } = this;
    this.range(...this.span(from));
    this.looked_s = newest_s;
    this.stale = false;
    this.wide = this.canvas.width - this.left;
    this.pixels_s = this.wide / WINDOW_S;
    // the right edge, counted in whole pixels from time 0
    this.edge = Math.ceil(Math.max(newest_s * this.pixels_s, this.time[from] * this.pixels_s + this.wide));
    this.blank();
    this.uprights(this.edge - this.wide, this.edge);
    pen.save();
    pen.beginPath();
    pen.rect(this.left, 0, this.wide, this.canvas.height);
    pen.clip();
    this.curves(from, true);
    pen.restore();
  }

  more(newest_s, from) {
    const { pen, canvas } = this, by = Math.ceil(newest_s * this.pixels_s) - this.edge;
    if (by > 0) {
      pen.drawImage(canvas, this.left + by, 0, this.wide - by, canvas.height, this.left, 0, this.wide - by, canvas.height);
      pen.fillStyle = this.paper;
      pen.fillRect(canvas.width - by, 0, by, canvas.height);
      this.lines(canvas.width - by, canvas.width);
      this.uprights(this.edge, this.edge + by);
      this.edge += by;
    }
    this.curves(from, false);
  }

  // Upright lines whose label fits between two places, counted as `edge` is.
  uprights(from, to) {
    const half = 14 * this.ratio, step = TICK_S * this.pixels_s;
    for (let at = Math.ceil((from - half) / step); at * step + half < to; at++)
      if (at * step + half >= from && at >= 0) this.upright(at * step - to + this.canvas.width, String(at * TICK_S));
  }

  // The curves from a sample on; where many are in one column of pixels, its first, lowest, highest and last one.
  curves(from, thinned) {
    const { pen, time } = this, shift = this.canvas.width - this.edge;
    pen.lineWidth = 1.4 * this.ratio;
    pen.lineJoin = "bevel";
    this.series.forEach((values, number) => {
      pen.strokeStyle = this.colours[number];
      pen.beginPath();
      let open = false, column = null, low = 0, high = 0, last = 0;
      const close = () => {
        if (column === null) return;
        if (low < last) pen.lineTo(column, this.y(low));
        if (high > last) pen.lineTo(column, this.y(high));
        pen.lineTo(column, this.y(last));
        column = null;
      };
      for (let at = from; at < time.length; at++) {
        const value = values[at] === null ? null : values[at] * this.scale;
        if (value === null) {
          close();
          open = false;
          continue;
        }
        let x = time[at] * this.pixels_s + shift;
        if (thinned) x = Math.round(x);
        if (!open) pen.moveTo(x, this.y(value));
        else if (x !== column) {
          close();
          pen.lineTo(x, this.y(value));
        }
        open = true;
        if (!thinned) continue;
        if (x !== column) [column, low, high] = [x, value, value];
        else [low, high] = [Math.min(low, value), Math.max(high, value)];
        last = value;
      }
      close();
      pen.stroke();
    });
  }
}

class Dots extends Plot {
  constructor(place, title, unit, colours) {
    super(place, title, `[${unit}] over poses`, colours);
  }

  // series: values of every pose, null where there is none
  show(series) {
    this.series = series;
    this.stale = true;
    this.draw();
  }

  draw() {
    if (!this.stale) return;
    this.stale = false;
    const known = this.series.flat().filter((value) => value != null), { pen } = this;
    this.range(...(known.length ? [Math.min(...known), Math.max(...known)] : [null, null]));
    this.blank();
    const poses = Math.max(4, ...this.series.map((values) => values.length));
    const step = (this.canvas.width - this.left) / poses, each = Math.ceil((40 * this.ratio) / step);
    for (let pose = 1; pose <= poses; pose += each) this.upright(this.left + (pose - 0.5) * step, String(pose));
    this.series.forEach((values, number) => {
      pen.fillStyle = this.colours[number];
      values.forEach((value, at) => {
        if (value == null) return;
        pen.beginPath();
        pen.arc(this.left + (at + 0.5) * step, this.y(value), 3 * this.ratio, 0, 2 * Math.PI);
        pen.fill();
      });
    });
  }
}

// A margin above and below, and never a range so small that noise fills it.
function withMargin(low, high) {
  if (low == null || high == null) return [-1, 1];
  const pad = Math.max(0.1 * (high - low), 0.02 * Math.max(Math.abs(low), Math.abs(high)), 1e-3);
  return [low - pad, high + pad];
}

// The next of 1, 2, 2.5, 5 and 10 times a power of ten.
function nice(step) {
  const power = 10 ** Math.floor(Math.log10(step));
  return power * [1, 2, 2.5, 5, 10].find((factor) => factor * power >= step * (1 - 1e-9));
}
