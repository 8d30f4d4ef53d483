// The arm as it stands: convex bodies, turned by the frames of their links, drawn from back to front.
// A plane canvas is enough for some hundred faces, and needs no graphics processor.
"use strict";

const HOME = { azimuth: -1.08, elevation: 0.3 };
const LIGHT = [-0.35, -0.5, 0.79];

class ArmView {
  constructor(canvas, arm) {
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
    });
    canvas.addEventListener("dblclick", () => { this.turn = { ...HOME }; this.stale = true; });
  }

  restyle() {
    const style = getComputedStyle(document.documentElement);
    const read = (name) => style.getPropertyValue(name).trim();
    this.colour = { link: rgb(read("--link")), edge: read("--edge"), box: read("--box"), grid: read("--grid"), ink: read("--muted") };
    this.stale = true;
  }

  pose(frames) {
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
        faces.push({ depth: depth / face.length, flat, face, shade: shade(world, face), load: body.load });
      }
    }
    faces.sort((one, other) => other.depth - one.depth);
    pen.lineJoin = "round";
    pen.lineWidth = 0.6 * ratio;
    for (const { flat, face, shade: bright } of faces) {
      const [r, g, b] = this.colour.link.map((value) => Math.round(Math.min(255, value * bright)));
      pen.fillStyle = pen.strokeStyle = `rgb(${r},${g},${b})`;
      pen.beginPath();
      face.forEach((corner, index) => (index ? pen.lineTo(flat[corner][0], flat[corner][1]) : pen.moveTo(flat[corner][0], flat[corner][1])));
      pen.closePath();
      pen.fill();
      pen.stroke();
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

function shade(world, face) {
  const [a, b, c] = face.map((corner) => world[corner]);
  const u = [b[0] - a[0], b[1] - a[1], b[2] - a[2]], v = [c[0] - a[0], c[1] - a[1], c[2] - a[2]];
  const n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
  const length = Math.hypot(n[0], n[1], n[2]) || 1;
  return 0.72 + 0.42 * (n[0] * LIGHT[0] + n[1] * LIGHT[1] + n[2] * LIGHT[2]) / length;
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
