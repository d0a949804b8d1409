// The player: one time, what belongs to it, and everything that moves it.
"use strict";

const data = JSON.parse(document.getElementById("data").textContent);
const part = (id) => document.getElementById(id);
const canvas = part("picture"), pen = canvas.getContext("2d", { willReadFrequently: true });  // drawn without a graphics card
const last = data.t.length - 1;
const STATES = ["slides", "sticks", "impulse"];
const MEMBERS = { L: "at the lower bound", F: "free", U: "at the upper bound", P: "passive" };
let frame = 0, filled = -1, time = data.t[0], playing = false, before = 0, asked = false;

const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`);
let ink;
function mix() {
  const names = ["ink", "soft", "earth", ...STATES];
  ink = Object.fromEntries(names.map((name) => [name, colour(name)]));
}

// The last step that is not later than t.
function frameAt(t) {
  let low = 0, high = last;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (data.t[middle] <= t) low = middle; else high = middle - 1;
  }
  return low;
}

// x, y, phi of every body, linear between two steps.
function poses() {
  const here = data.q[frame], next = data.q[Math.min(frame + 1, last)];
  const span = data.t[Math.min(frame + 1, last)] - data.t[frame];
  const share = span > 0 ? (time - data.t[frame]) / span : 0;
  return here.map((value, i) => value + share * (next[i] - value));
}

// The window of the scene in the middle of the picture, in one scale: metres to pixels.
function view() {
  const [left, right, bottom, top] = data.window;
  const scale = Math.min(canvas.width / (right - left), canvas.height / (top - bottom));
  const x0 = (canvas.width - scale * (right - left)) / 2 - scale * left;
  const y0 = (canvas.height + scale * (top - bottom)) / 2 + scale * bottom;
  return { scale, at: (x, y) => [x0 + scale * x, y0 - scale * y] };
}

function path(points, closed = true) {
  pen.beginPath();
  for (const point of points) pen.lineTo(...point);
  if (closed) pen.closePath();
}

function drawGround(to) {
  const far = 4 * Math.max(canvas.width, canvas.height) / to.scale;
  for (const [x, y, nx, ny] of data.ground) {
    const ends = [[x - far * ny, y + far * nx], [x + far * ny, y - far * nx]];
    const deep = ends.map(([a, b]) => [a - far * nx, b - far * ny]).reverse();
    path([...ends, ...deep].map((point) => to.at(...point)));
    pen.fillStyle = ink.earth;
    pen.fill();
  }
}

function drawBody(to, body, [x, y, phi]) {
  const cos = Math.cos(phi), sin = Math.sin(phi);
  const moved = ([a, b]) => to.at(x + cos * a - sin * b, y + sin * a + cos * b);
  for (const corners of data.parts[body]) {
    path(corners.map(moved));
    if (corners.length < 3) {  // a disc or an ellipse, with a spoke
      const a = corners[0][0], b = corners[corners.length - 1][corners.length - 1];
      const axes = [a, b].map((length) => Math.max(to.scale * length, 0.5));
      pen.beginPath();
      pen.ellipse(...to.at(x, y), ...axes, -phi, 0, 7);
      pen.moveTo(...moved([0.4 * a, 0]));
      pen.lineTo(...moved([a, 0]));
    }
    pen.globalAlpha = 0.5;
    pen.fillStyle = data.colours[body % data.colours.length];
    pen.fill();
    pen.globalAlpha = 1;
    pen.strokeStyle = ink.ink;
    pen.stroke();
  }
  pen.fillStyle = ink.ink;
  pen.fillText(body + 1, ...to.at(x, y));
}

// A point of a body in the plane; the ground is body -1.
function placed(q, body, a, b) {
  if (body < 0) return [a, b];
  const [x, y, phi] = q.slice(3 * body, 3 * body + 3);
  const cos = Math.cos(phi), sin = Math.sin(phi);
  return [x + cos * a - sin * b, y + sin * a + cos * b];
}

function drawLink(to, [body, a, b, other, c, d], q, stroke) {
  path([to.at(...placed(q, other, c, d)), to.at(...placed(q, body, a, b))], false);
  pen.strokeStyle = stroke;
  pen.lineCap = "round";
  pen.stroke();
}

function drawForce(to, [, x, y, fx, fy, state]) {
  const size = Math.hypot(fx, fy) / data.largest[state === 2 ? 1 : 0];
  pen.strokeStyle = pen.fillStyle = ink[STATES[state]];
  const [px, py] = to.at(x, y);
  pen.beginPath();
  pen.arc(px, py, 2.5 * devicePixelRatio, 0, 7);
  pen.fill();
  if (size < 1e-6) return;
  const dash = state === 0 ? [5 * devicePixelRatio, 3 * devicePixelRatio] : [];
  drawArrow(px, py, Math.atan2(-fy, fx), 0.2 * canvas.height * Math.min(size, 1.5), dash);
}

function drawArrow(x, y, angle, length, dash) {
  const tip = Math.min(8 * devicePixelRatio, length);
  pen.save();
  pen.translate(x, y);
  pen.rotate(angle);
  pen.lineWidth = 2 * devicePixelRatio;
  pen.setLineDash(dash);
  path([[0, 0], [length - tip, 0]], false);
  pen.stroke();
  path([[length, 0], [length - tip, tip / 2], [length - tip, -tip / 2]]);
  pen.fill();
  pen.restore();
}

function drawPicture() {
  const to = view(), q = poses();
  pen.clearRect(0, 0, canvas.width, canvas.height);
  pen.lineWidth = devicePixelRatio;
  pen.font = `bold ${11 * devicePixelRatio}px sans-serif`;
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  if (data.space) return drawSpace(to, q);
  drawGround(to);
  for (const spring of data.springs) drawLink(to, spring, q, ink.soft);
  for (let body = 0; body < data.parts.length; body++) drawBody(to, body, q.slice(3 * body, 3 * body + 3));
  pen.lineWidth = 3 * devicePixelRatio;
  for (const bar of data.bars) drawLink(to, bar, q, ink.ink);
  for (const force of data.forces[frame]) drawForce(to, force);
}

function members(text) {
  const counts = Object.entries(MEMBERS)
    .map(([letter, name]) => [[...text].filter((each) => each === letter).length, name])
    .filter(([count]) => count);
  return counts.map(([count, name]) => `${count} ${name}`).join(", ") + (text ? ` (${text})` : "");
}

// A text is set only where it changes: what stays needs no new layout.
function say(element, text) {
  if (element.firstChild?.data !== String(text)) element.textContent = text;
}

// Rows of names and values; elements are made once, then only their texts change.
function fill(table, entries) {
  while (table.rows.length < entries.length) {
    const row = table.insertRow();
    row.append(document.createElement("th"));
    row.insertCell().append(document.createElement("span"), document.createElement("b"));
  }
  entries.forEach(([name, value], i) => {
    say(table.rows[i].cells[0], name);
    say(table.rows[i].cells[1].firstChild, value);
  });
}

function fillWork() {
  const entries = Object.entries(data.iterations);
  fill(part("work"), entries.map(([name, each]) => [name, each[frame] ?? "not stored"]));
  const most = Math.max(1, ...entries.map(([, each]) => each[frame] ?? 0));
  entries.forEach(([, each], i) => {
    const share = Math.log1p(each[frame] ?? 0) / Math.log1p(most);
    part("work").rows[i].cells[1].lastChild.style.transform = `scaleX(${share})`;
  });
}

function fillQp() {
  const [number, kind, k, set] = data.qps[frame] ?? ["none", "no QP was posed", 0, ""];
  const rank = data.rank?.[frame] ?? "not stored";
  fill(part("qp"), [["QP", `${number} (${kind})`], ["k", k], ["rank", rank], ["active set", members(set)]]);
}

function lastEvent() {
  const past = data.events.filter(([t]) => t <= time);
  return past.length ? past[past.length - 1] : null;
}

function show() {
  asked = false;
  drawPicture();
  part("time").value = time;
  say(part("clock"), `${time.toFixed(4)} s · step ${frame + 1} of ${last + 1}`);
  const event = lastEvent();
  say(part("said"), event ? `Last event, ${event[0].toFixed(4)} s: ${event[1].replaceAll("_", " ")}. ${event[2]}` : "");
  if (frame === filled) return;
  filled = frame;
  fillQp();
  fillWork();
}

// However often the time changes, there is one picture per frame of the screen.
function soon() {
  if (!asked) requestAnimationFrame(show);
  asked = true;
}

function goTo(t) {
  time = Math.min(Math.max(t, data.t[0]), data.t[last]);
  frame = frameAt(time);
  soon();
}

function step(by) {
  play(false);
  frame = Math.min(Math.max(frame + by, 0), last);
  time = data.t[frame];
  soon();
}

function tick(now) {
  if (!playing) return;
  goTo(time + ((now - before) / 1000) * Number(part("speed").value));
  before = now;
  if (frame === last) play(false);
  requestAnimationFrame(tick);
}

function play(on) {
  if (on && frame === last) goTo(data.t[0]);
  const starts = on && !playing;
  playing = on;
  part("play").textContent = on ? "‖ pause" : "▶ play";
  if (!starts) return;
  before = performance.now();
  requestAnimationFrame(tick);
}

function jump(t) {
  play(false);
  goTo(t);
}

// Events of one time share a mark.
function markEvents() {
  const marks = new Map();
  for (const [t, kind, detail] of data.events) {
    const item = document.createElement("li"), button = document.createElement("button");
    button.textContent = `${t.toFixed(4)} s: ${kind.replaceAll("_", " ")}. ${detail}`;
    button.addEventListener("click", () => jump(t));
    item.append(button);
    part("list").append(item);
    if (!marks.has(t)) marks.set(t, { kind, words: [] });
    marks.get(t).words.push(`${kind.replaceAll("_", " ")} ${detail}`);
  }
  for (const [t, { kind, words }] of marks) {
    const button = document.createElement("button");
    button.className = kind;
    button.title = `${t.toFixed(4)} s: ${words.join("; ")}`;
    button.setAttribute("aria-label", button.title);
    button.tabIndex = -1;  // the list below is for keys
    button.style.left = `${(100 * (t - data.t[0])) / (data.t[last] - data.t[0] || 1)}%`;
    button.addEventListener("click", () => jump(t));
    part("events").append(button);
  }
}

const KEYS = {
  " ": () => play(!playing),
  ArrowLeft: () => step(-1),
  ArrowRight: () => step(1),
  Home: () => jump(data.t[0]),
  End: () => jump(data.t[last]),
};

function resize() {
  canvas.width = canvas.clientWidth * devicePixelRatio;
  canvas.height = canvas.clientHeight * devicePixelRatio;
  mix();
  show();
}

function drag(event) {
  if (!event.buttons) return;
  if (data.space) return turn(event);
  jump(time + (event.movementX / canvas.clientWidth) * (data.t[last] - data.t[0]));
}

function connect() {
  part("time").min = data.t[0];
  part("time").max = data.t[last];
  part("time").addEventListener("input", () => jump(Number(part("time").value)));
  part("play").addEventListener("click", KEYS[" "]);
  part("first").addEventListener("click", KEYS.Home);
  part("last").addEventListener("click", KEYS.End);
  part("back").addEventListener("click", KEYS.ArrowLeft);
  part("on").addEventListener("click", KEYS.ArrowRight);
  canvas.addEventListener("pointermove", drag);
  addEventListener("keydown", (event) => {
    const typed = event.target.matches("select, summary, button") && event.key === " ";
    if (!KEYS[event.key] || typed || event.target.matches("select")) return;
    event.preventDefault();
    KEYS[event.key]();
  });
  addEventListener("resize", resize);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", resize);
}

connect();
markEvents();
resize();
