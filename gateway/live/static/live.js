// Messages of the socket go into the page; the button is the one thing that goes back.
"use strict";

const byId = (id) => document.getElementById(id);
const token = new URLSearchParams(location.search).get("token") || "";
const KINDS = ["q", "speed", "error", "torque", "model"];
const MOST_ROWS = 2600;
// Between two numbers in the same place [ms]: faster ones cannot be read.
const WRITTEN_MS = 90;
// How long a frame took to the screen is looked at in one of so many.
const LOOKED_AT = 4;

class Arm {
  constructor(arm) {
    const part = byId("arm").content.cloneNode(true).firstElementChild;
    byId("arms").append(part);
    this.part = part;
    this.arm = arm;
    this.view = new ArmView(part.querySelector("canvas"), arm, ask);
    this.time = [];
    this.values = KINDS.map(() => Array.from({ length: arm.axes }, () => []));
    part.querySelector("h2").textContent = `Arm ${arm.name}`;
    const assumed = part.querySelector(".assumed");
    assumed.textContent = arm.assumed.length ? `Shape assumed: ${arm.assumed.map((each) => each.split(":")[0]).join(", ")}.` : "";
    assumed.title = arm.assumed.join("\n");
    this.cells = this.table();
    this.charts = this.curves();
    this.rest = null;
    this.poses = [];
  }

  table() {
    const body = this.part.querySelector("tbody");
    return Array.from({ length: this.arm.axes }, (_, joint) => {
      const row = body.insertRow();
      row.insertCell().textContent = `J${joint + 1}`;
      const cells = [row.insertCell(), ...KINDS.map(() => row.insertCell())];
      cells.forEach((cell, index) => (cell.className = index ? "n" : "state"));
      return cells;
    });
  }

  curves() {
    const torque = this.part.querySelector(".torque"), motion = this.part.querySelector(".motion");
    const joints = Array.from({ length: this.arm.axes }, (_, joint) => joint);
    const colours = joints.map((joint) => `--j${(joint % 8) + 1}`);
    for (const joint of joints) {
      const label = document.createElement("span"), mark = document.createElement("i");
      mark.className = "k-joint";
      mark.style.borderColor = `var(${colours[joint]})`;
      label.append(mark, `J${joint + 1}`);
      this.part.querySelector(".joints").append(label);
    }
    return {
      torque: joints.map((joint) => new Strip(torque, `J${joint + 1} torque`, "Nm", this.arm.modelled ? ["--model", "--torque"] : ["--torque"])),
      motion: [["position", "rad", 1], ["speed", "rad/s", 1], ["following error", "mrad", 1e3]].map(
        ([name, unit, scale]) => new Strip(motion, name, unit, colours, scale),
      ),
    };
  }

  take(told) {
    const axes = this.arm.axes;
    for (const row of told.rows) {
      if (this.time.length && row[0] < this.time[this.time.length - 1]) this.drop(this.time.length);
      this.time.push(row[0]);
      this.values.forEach((kind, number) => kind.forEach((joint, index) => joint.push(row[1 + number * axes + index])));
    }
    const first = this.time.length ? this.time[this.time.length - 1] - WINDOW_S : 0;
    let old = Math.max(0, this.time.length - MOST_ROWS);
    while (old < this.time.length && this.time[old] < first) old++;
    if (old > 200 || old >= this.time.length - MOST_ROWS / 2) this.drop(old);
    if (told.frames) this.view.pose(told.frames);
    if (told.drives) this.drives = told.drives;
  }

  drop(count) {
    if (!count) return;
    this.time.splice(0, count);
    for (const kind of this.values) for (const joint of kind) joint.splice(0, count);
  }

  draw() {
    this.view.draw();
    const [q, speed, error, torque, model] = this.values;
    this.charts.torque.forEach((chart, joint) =>
      chart.show(this.time, this.arm.modelled ? [model[joint], torque[joint]] : [torque[joint]]));
    const [place, rate, off] = this.charts.motion;
    place.show(this.time, q);
    rate.show(this.time, speed);
    off.show(this.time, error);
  }

  write() {
    this.cells.forEach((cells, joint) => {
      const [state, grave] = (this.drives && this.drives[joint]) || ["-", "plain"];
      cells[0].textContent = state;
      cells[0].className = `state ${grave}`;
      const last = (kind) => this.values[kind][joint][this.time.length - 1];
      const put = (cell, value, digits, limit, radians) => {
        const degrees = radians == null || value == null ? "" : ` (${(radians * value * 180 / Math.PI).toFixed(2)})`;
        cell.textContent = value == null ? "-" : (Number(value.toFixed(digits)) || 0).toFixed(digits) + degrees;
        cell.classList.toggle("over", value != null && limit != null && Math.abs(value) > limit);
      };
      put(cells[1], last(0), 4, null, 1);
      put(cells[2], last(1), 3, this.arm.speed_rad_s[joint], 1);
      put(cells[3], last(2) == null ? null : 1e3 * last(2), 2, 1e3 * this.arm.following_error_rad[joint], 1e-3);
      put(cells[4], last(3), 2, this.arm.torque_nm[joint]);
      put(cells[5], this.arm.modelled ? last(4) : null, 2);
    });
  }

  pose(pose) {
    const place = this.part.querySelector(".rest");
    this.part.querySelector(".poses").hidden = false;
    if (!this.rest) {
      const colours = Array.from({ length: this.arm.axes }, (_, joint) => `--j${(joint % 8) + 1}`);
      this.rest = { band: new Dots(place, "friction band", "Nm", colours) };
      if (pose.residual_nm) this.rest.residual = new Dots(place, "measured less model without load", "Nm", colours);
    }
    this.poses.push(pose);
    const joints = (key) => Array.from({ length: this.arm.axes }, (_, joint) => this.poses.map((each) => each[key] && each[key][joint]));
    this.rest.band.show(joints("band_nm"));
    if (this.rest.residual) this.rest.residual.show(joints("residual_nm"));
  }

  all() {
    return [...this.charts.torque, ...this.charts.motion, ...(this.rest ? Object.values(this.rest) : [])];
  }
}

const live = { arms: [], fresh: false, over: false, stops: true, frames: 0, lag_ms: [], cost_ms: [], presses: 0, socket: null, wall_ms: 0, poses: [] };

function receive(message) {
  if (message.hello) {
    document.querySelector("h1").textContent = document.title = message.hello.title;
    live.stops = message.hello.stops;
    live.poses = [];
    byId("events").replaceChildren();
    arm_button();
  } else if (message.scene) {
    byId("arms").replaceChildren();
    live.arms = message.scene.arms.map((arm) => new Arm(arm));
    for (const pose of live.poses) live.arms[0]?.pose(pose);
    live.fresh = true;
    ask();
  } else if (message.frame) {
    message.frame.arms.forEach((told, index) => live.arms[index]?.take(told));
    standing = message.frame;
    live.wall_ms = message.frame.wall_ms || 0;
    live.fresh = true;
    ask();
  } else if (message.event) announce(message.event);
  else if (message.pose) {
    live.poses.push(message.pose);
    live.arms[0]?.pose(message.pose);
  } else if (message.over) end(message.over);
}

function showStill(frame) {
  const phase = byId("phase");
  phase.textContent = frame.phase || "-";
  phase.classList.toggle("fail", /^(stopped|in an unknown)/.test(frame.phase));
  byId("what").textContent = frame.what;
  byId("left").textContent = frame.left_s == null ? "-" : clock(frame.left_s);
  byId("sync").textContent = frame.sync;
  byId("unanswered").textContent = frame.unanswered;
}

function clock(seconds) {
  return seconds < 60 ? `${seconds.toFixed(0)} s` : `${Math.floor(seconds / 60)} min ${Math.floor(seconds % 60)} s`;
}

function announce(event) {
  const item = document.createElement("li"), at = document.createElement("time");
  item.className = event.grave;
  at.textContent = `${event.at} UTC`;
  item.append(at, event.text);
  const list = byId("events");
  list.prepend(item);
  while (list.children.length > 40) list.lastElementChild.remove();
}

function end(reason) {
  live.over = true;
  const line = byId("over");
  line.hidden = false;
  line.classList.toggle("bad", reason !== "The command has ended.");
  line.textContent = reason;
  arm_button();
}

function arm_button() {
  const button = byId("stop"), open = live.socket && live.socket.readyState === WebSocket.OPEN;
  button.disabled = live.over || !live.stops || !open;
  button.textContent = live.stops ? (live.presses ? "STOP AT ONCE" : "STOP") : "ONLY WATCHES";
  button.title = live.stops
    ? "Stops the arm on its path; pressed again, at once by the drives' quick stop"
    : "This page only listens to the bus: stop the arm where it is moved from";
  byId("link").textContent = live.over ? "ended" : open ? "connected" : "not connected";
}

byId("stop").addEventListener("click", () => {
  live.socket.send("stop");
  live.presses += 1;
  byId("stop").classList.add("asked");
  arm_button();
});

function connect() {
  live.socket = new WebSocket(`ws://${location.host}/feed?token=${encodeURIComponent(token)}`);
  live.socket.onopen = arm_button;
  live.socket.onmessage = (message) => receive(JSON.parse(message.data));
  live.socket.onclose = () => {
    arm_button();
    if (!live.over) setTimeout(connect, 1000);
  };
}

// A frame is asked for when there is something to draw: a page that has nothing to show leaves the processor alone.
let asked = false, written = 0, last_word = 0, standing = null;
function ask() {
  if (!asked) requestAnimationFrame(draw);
  asked = true;
}

function draw(now) {
  asked = false;
  const before = performance.now(), wall_ms = live.wall_ms, fresh = live.fresh;
  live.fresh = false;
  for (const arm of live.arms) arm.draw();
  if (now - written > WRITTEN_MS) {
    written = now;
    for (const arm of live.arms) arm.write();
    if (standing) showStill(standing);
    clearTimeout(last_word);
    last_word = 0;
  } else if (!last_word) last_word = setTimeout(ask, 2 * WRITTEN_MS); // should nothing come any more
  if (!fresh) return;
  live.frames += 1;
  keep(live.cost_ms, performance.now() - before);
  // what was drawn is on the screen when the next frame begins
  if (wall_ms && live.frames % LOOKED_AT === 0) requestAnimationFrame(() => keep(live.lag_ms, Date.now() - wall_ms));
}

function keep(list, value) {
  list.push(value);
  if (list.length > 2000) list.shift();
}

function redraw() {
  for (const arm of live.arms) {
    arm.view.restyle();
    for (const chart of arm.all()) {
      chart.restyle();
      chart.draw();
    }
  }
  ask();
}

window.addEventListener("resize", () => {
  for (const arm of live.arms) for (const chart of arm.all()) chart.resize();
  redraw();
});
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
connect();
