// The arm in its present posture: convex bodies, turned by the frames of their links, drawn from back to front.
// A plane canvas is enough for some hundred faces, and needs no graphics processor.
"use strict";

const HOME = { azimuth: -1.08, elevation: 0.3 };
const LIGHT = [-0.35, -0.5, 0.79];
// Frames that differ by less [1 and m] are equal on a screen.
const STILL = 2e-4;
// Colours between a face that is turned away from the light and one that faces it.
const SHADES = 64;

class ArmView {
  // changed: called when a person has turned the picture
  constructor(canvas, arm, changed) {
    this.canvas = canvas;
    this.arm = arm;
    this.turn = { ...HOME };
    this.frames = null;
    this.stale = true;
    this.restyle();
    canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
    canvas.addEventListener("pointermove", (event) => {
      if (!event.buttons) return;
      this.turn.azimuth -= event.movementX * 0.01;
      this.turn.elevation = Math.min(1.5, Math.max(-0.3, this.turn.elevation + event.movementY * 0.01));
      this.stale = true;
      changed();
    });
    canvas.addEventListener("dblclick", () => { this.turn = { ...HOME }; this.stale = true; changed(); });
  }

  restyle() {
    const style = getComputedStyle(document.documentElement);
    const read = (name) => style.getPropertyValue(name).trim();
    this.colour = { link: rgb(read("--link")), box: read("--box"), grid: read("--grid"), ink: read("--muted") };
    this.shades = Array.from({ length: SHADES }, (_, at) => {
      const bright = 0.3 + (0.84 * at) / (SHADES - 1);
      return `rgb(${this.colour.link.map((value) => Math.round(Math.min(255, value * bright))).join()})`;
    });
    this.stale = true;
  }

  // An arm at rest is not drawn again.
  pose(frames) {
    if (this.frames && frames.every((frame, link) => frame.every((value, at) => Math.abs(value - this.frames[link][at]) < STILL))) return;
    this.frames = frames;
    this.stale = true;
  }

  draw() {
    if (!this.stale) return;
    this.stale = false;
    const ratio = window.devicePixelRatio || 1, shown = this.canvas.clientWidth || 460;
    const width = Math.round(shown * ratio), height = Math.round(shown * ratio * 0.82);
    if (this.canvas.width !== width) { this.canvas.width = width; this.canvas.height = height; }
    const pen = this.canvas.getContext("2d");
    pen.clearRect(0, 0, width, height);
    const view = this.view(width, height);
    this.floor(pen, view);
    for (const box of this.arm.boxes) this.box(pen, view, box);
    this.bodies(pen, view, ratio);
  }

  view(width, height) {
    const { azimuth, elevation } = this.turn, reach = this.arm.reach_m;
    const ca = Math.cos(azimuth), sa = Math.sin(azimuth), ce = Math.cos(elevation), se = Math.sin(elevation);
    const scale = Math.min(width / (2.3 * reach), height / (1.9 * reach)), across = width / 2, up = height * 0.72;
    return (x, y, z) => {
      const depth = ca * x + sa * y;
      return [across + scale * (ca * y - sa * x), up - scale * (ce * z - se * depth), ce * depth + se * z];
    };
  }

  floor(pen, view) {
    pen.strokeStyle = this.colour.grid;
    pen.lineWidth = 1;
    const reach = this.arm.reach_m, step = reach / 4;
    for (let at = -4; at <= 4; at++) {
      line(pen, view(at * step, -reach, 0), view(at * step, reach, 0));
      line(pen, view(-reach, at * step, 0), view(reach, at * step, 0));
    }
    pen.fillStyle = this.colour.ink;
    pen.font = `${11 * (window.devicePixelRatio || 1)}px sans-serif`;
    for (const [name, x, y, z] of [["x", 1, 0, 0], ["y", 0, 1, 0], ["z", 0, 0, 1]]) {
      const end = view(x * step, y * step, z * step);
      pen.strokeStyle = this.colour.ink;
      line(pen, view(0, 0, 0), end);
      pen.fillText(name, end[0] + 3, end[1]);
    }
  }

  box(pen, view, [low, high]) {
    const far = 1.6 * this.arm.reach_m;
    const [a, b] = [low, high].map((corner) => corner.map((value) => Math.max(-far, Math.min(far, value))));
    const corner = (i) => view(i & 1 ? b[0] : a[0], i & 2 ? b[1] : a[1], i & 4 ? b[2] : a[2]);
    pen.strokeStyle = this.colour.box;
    pen.globalAlpha = 0.45;
    for (const [i, j] of [[0, 1], [0, 2], [0, 4], [1, 3], [1, 5], [2, 3], [2, 6], [3, 7], [4, 5], [4, 6], [5, 7], [6, 7]])
      line(pen, corner(i), corner(j));
    pen.globalAlpha = 1;
  }

  bodies(pen, view, ratio) {
    const faces = [];
    for (const body of this.arm.bodies) {
      const frame = body.link < 0 ? null : this.frames && this.frames[body.link];
      if (body.link >= 0 && !frame) continue;
      const world = body.points.map((p) => frame ? moved(frame, p) : p);
      const flat = world.map((p) => view(p[0], p[1], p[2]));
      for (const face of body.faces) {
        if (turned(flat, face) >= 0) continue;
        let depth = 0;
        for (const corner of face) depth += flat[corner][2];
        faces.push({ depth: depth / face.length, flat, face, colour: this.shades[shade(world, face)] });
      }
    }
    faces.sort((one, other) => other.depth - one.depth);
    for (const { flat, face, colour } of faces) {
      pen.fillStyle = colour;
      pen.beginPath();
      grown(pen, flat, face, 0.4 * ratio);
      pen.fill();
    }
  }
}

function moved(f, p) {
  return [
    f[0] * p[0] + f[1] * p[1] + f[2] * p[2] + f[3],
    f[4] * p[0] + f[5] * p[1] + f[6] * p[2] + f[7],
    f[8] * p[0] + f[9] * p[1] + f[10] * p[2] + f[11],
  ];
}

// Twice the signed area on the screen, where y points down: negative = its outside is seen.
function turned(flat, face) {
  const [a, b, c] = face;
  return (flat[b][0] - flat[a][0]) * (flat[c][1] - flat[a][1]) - (flat[b][1] - flat[a][1]) * (flat[c][0] - flat[a][0]);
}

// A convex face with every edge moved outwards, so that no gap shows to the next one: stroking it costs as much again.
function grown(pen, flat, face, by) {
  const count = face.length;
  let from = flat[face[count - 1]], at = flat[face[0]], [x, y] = outwards(from, at);
  for (let index = 0; index < count; index++) {
    const to = flat[face[(index + 1) % count]], [nx, ny] = outwards(at, to);
    const reach = by / Math.max(0.5, 1 + x * nx + y * ny), right = at[0] + reach * (x + nx), down = at[1] + reach * (y + ny);
    if (index) pen.lineTo(right, down);
    else pen.moveTo(right, down);
    [x, y, at] = [nx, ny, to];
  }
  pen.closePath();
}

// Out of a face whose outside is seen, across one of its edges; of length 1.
function outwards(from, to) {
  const x = to[0] - from[0], y = to[1] - from[1], length = Math.sqrt(x * x + y * y) || 1;
  return [-y / length, x / length];
}

// How bright a face is: a place in `shades`.
function shade(world, face) {
  const a = world[face[0]], b = world[face[1]], c = world[face[2]];
  const ux = b[0] - a[0], uy = b[1] - a[1], uz = b[2] - a[2], vx = c[0] - a[0], vy = c[1] - a[1], vz = c[2] - a[2];
  const x = uy * vz - uz * vy, y = uz * vx - ux * vz, z = ux * vy - uy * vx;
  const towards = (x * LIGHT[0] + y * LIGHT[1] + z * LIGHT[2]) / (Math.sqrt(x * x + y * y + z * z) || 1);
  return Math.max(0, Math.min(SHADES - 1, Math.round((0.5 + 0.5 * towards) * (SHADES - 1))));
}

function line(pen, from, to) {
  pen.beginPath();
  pen.moveTo(from[0], from[1]);
  pen.lineTo(to[0], to[1]);
  pen.stroke();
}

function rgb(hex) {
  return [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16));
}
