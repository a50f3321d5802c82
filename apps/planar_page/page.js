"use strict";
// Draws what the libraries compute, and passes on what the user does. No number is computed here.
const $ = id => document.getElementById(id);
const VIEW = {left: -0.4, right: 4.4, bottom: -1.15, top: 1.15};
const CELL = 9;  // pixels between the points at which the support is evaluated
const POLICY = 0, PROBE = 1, RECOVERY = 2, HALT = 3;
const MODES = ["learned", "probe", "recovery", "halted"];
const OUTCOMES = ["completed", "halted", "collided"];
const METHODS = {
  "baseline": ["The policy alone", "The learned policy acts unguarded."],
  "early-stopping": ["Early stopping", "Halts where the next control could leave the support: g ≤ λ|u|."],
  "dfr": ["DFR, as published", "Where g ≤ λ|u|, small random probes find out which way g rises."],
  "guided": ["Guided recovery", "Every applied control teaches how the robot answers. The policy's control is changed as little as it takes."],
  "certified-direction": ["Certified", "A control passes only if the state that it leads to is provably inside the support."],
};

let kernel, world;  // the libraries; what they say of scenes and methods
const call = (name, ...args) => {
  const result = kernel["_page_" + name](...args);
  if (result === -1) throw new Error(kernel.UTF8ToString(kernel._page_error()));
  return result;
};
// The shared array, which may have moved since.
const numbers = (count, first = 0) => {
  const start = kernel._page_array(first + count) / 8 + first;
  return kernel.HEAPF64.subarray(start, start + count);
};
const page = {
  scene: 0, method: 3, tool: "move", running: false, seed: 1, phase: 0, demonstrations: [], paths: null,
  robot: [0, 0], history: [], at: 0, outcome: -1, cause: 0, alone: null, preview: null, line: null, pen: null,
  levels: null, fitMs: NaN, certifiedMs: NaN, decisionUs: NaN, fitted: false, certified: false, later: 0, tally: null, due: 0, share: 1, dirty: true, frames: 0,
};
const scene = () => world.scenes[page.scene];
const support = () => world.methods[page.method].support;

function say(text) {
  $("message").textContent = text;
  $("message").hidden = !text;
}

// --- What the user asks for -------------------------------------------------------------------

function openScene(index, count = 60) {
  page.scene = index;
  call("open", index);
  page.line = null;
  say("");
  if (scene().routes > 0) call("demonstrate", count, 1);
  page.seed = 1;
  learn();
  // Of the first starts one from which the policy alone does not complete, if there is one.
  while (page.alone && page.alone.outcome === 0 && page.seed < 20) newStart(true);
  setTool(scene().routes > 0 ? "move" : "draw");
  chosen("scenes", index);
  $("summary").textContent = scene().summary;
  $("prepared").disabled = scene().routes === 0;
}

// Fits to the demonstrations there are, and begins an episode.
function learn() {
  page.demonstrations = [];
  for (let i = 0;; ++i) {
    const points = kernel._page_demonstration(i);
    if (points < 0) break;
    page.demonstrations.push(Array.from(numbers(2 * points)));
  }
  page.paths = null;
  page.tally = null;
  page.fitted = page.certified = false;
  page.levels = null;
  const count = page.demonstrations.length;
  if (count >= 3) {
    const begin = performance.now();
    try {
      call("fit");
      page.fitMs = performance.now() - begin;
      page.fitted = true;
      if (support() === 2) learnCertified();
      page.decisionUs = decisionTime();
    } catch (error) {
      say(error.message);
    }
  }
  showFitted();
  newStart();
  showTally();
  clearTimeout(page.later);
  if (page.fitted) page.later = setTimeout(learnCertified, 300);
}

// Certificates take as long to learn as all else: what was learned is shown before.
function learnCertified() {
  if (page.certified || !page.fitted) return;
  const begin = performance.now();
  call("fit_certified");
  page.certifiedMs = performance.now() - begin;
  page.certified = true;
  for (const d of page.history) Object.assign(d, measures(d.t, d.from));
  showFitted();
  look();
}

function showFitted() {
  const count = page.demonstrations.length, steps = page.demonstrations.reduce((sum, d) => sum + d.length / 2, 0);
  const us = ms => Math.round(1000 * ms).toLocaleString("en") + " µs";
  $("fitted").textContent = page.fitted ?
    `${count} demonstrations, ${steps} states: learned in ${us(page.fitMs)}` +
    `${page.certified ? `, certificates in ${us(page.certifiedMs)}` : ""}. One decision takes ` +
    `${page.decisionUs.toFixed(page.decisionUs < 10 ? 1 : 0)} µs.` :
    count === 0 ? "None yet. Draw a line from start to goal." : `${count} so far; it takes three to learn from.`;
}

// Microseconds that guided recovery takes for a decision, over many.
function decisionTime() {
  const [x, y] = scene().start, begin = performance.now();
  let controls = 0;
  for (let i = 0; i < 30; ++i) controls += call("preview", 3, x, y, 0, 50);
  return 1000 * (performance.now() - begin) / controls;
}

function newStart(next = false) {
  if (next) ++page.seed;
  call("start_state", page.seed);
  begin(Array.from(numbers(2)), 0);
}

// An episode from `point` at time step `phase`.
function begin(point, phase) {
  page.robot = point;
  page.first = phase;
  page.phase = phase;
  page.history = [];
  page.at = 0;
  page.share = 1;
  page.outcome = -1;
  page.preview = page.alone = null;
  if (page.fitted) {
    call("start", page.method, ...point, phase, page.seed);
    page.alone = way(0, point, phase);
    look();
  }
  page.dirty = true;
}

// One control, remembered with all that it was decided on.
function control() {
  if (!page.fitted || page.outcome >= 0) return;
  call("step");
  const n = numbers(14);
  const d = {from: [n[0], n[1]], to: [n[2], n[3]], wanted: [n[4], n[5]], mode: n[6], t: n[7], threshold: n[9],
             changed: n[10] > 0, certified: n[11] > 0};
  page.outcome = n[12];
  page.cause = n[13];
  Object.assign(d, measures(d.t, d.from));
  page.history.push(d);
  page.at = page.history.length - 1;
  page.robot = d.to;
  page.phase = d.t;
  page.share = 0;
  if (page.outcome >= 0) run(false);
  look();
}

// l, g and what is certified at a point.
function measures(t, point) {
  call("look", support(), t, ...point);
  const n = numbers(5);
  return {l: n[0], g: n[1], centre: [n[2], n[3]], radius: n[4]};
}

function way(method, point, phase) {
  const count = call("preview", method, ...point, phase, 240);
  const n = numbers(2 * count + 1);
  return {points: Array.from(n.subarray(0, 2 * count)), outcome: n[2 * count]};
}

// What is shown of the present state while nothing runs.
function look() {
  if (!page.fitted) return;
  page.now = measures(page.phase, page.robot);
  page.preview = !page.running && page.outcome < 0 ? way(page.method, page.robot, page.phase) : null;
  page.dirty = true;
}

function run(on) {
  if (on && !page.fitted) return say("There is nothing to run yet: draw a demonstration.");
  if (on && page.outcome >= 0) newStart(true);
  page.running = on;
  page.due = 0;
  $("run").textContent = on ? "Pause" : "Run";
  say("");
  look();
  page.dirty = true;
}

function setMethod(index) {
  page.method = index;
  chosen("methods", index);
  $("method").textContent = METHODS[world.methods[index].name][1];
  page.levels = null;
  $("show-certificate").checked = support() === 2;
  if (support() === 2) learnCertified();
  if (page.fitted) begin(page.history.length ? page.history[0].from : page.robot, page.first);
}

function setTool(tool) {
  page.tool = tool;
  page.pen = null;
  page.line = null;
  chosen("tools", tool === "move" ? 0 : 1);
  $("map").classList.toggle("draw", tool === "draw");
  if (tool === "draw") run(false);
  page.dirty = true;
}

function chosen(group, index) {
  [...$(group).children].forEach((button, i) => {
    button.setAttribute("aria-checked", i === index);
    button.tabIndex = i === index ? 0 : -1;
  });
}

// The robot is put elsewhere: an episode of its own begins there, or the one that runs is disturbed.
function drag(point) {
  if (!page.fitted) return;
  if (page.running) {
    call("displace", ...point);
    page.robot = point;
    page.share = 1;
    page.dirty = true;
  } else {
    begin(point, call("nearest_step", support(), ...point));
  }
}

function endLine() {
  const line = page.line;
  page.line = page.pen = null;
  page.dirty = true;
  if (!line || line.length < 4) return;
  numbers(line.length).set(line);
  try {
    call("draw", line.length / 2, Math.max(0, Math.min(59, +$("repeats").value || 0)), ++page.seed);
    say("");
    learn();
  } catch (error) {
    say(error.message);
  }
}

let push = new Set();
function pushes(direction, on) {
  on ? push.add(direction) : push.delete(direction);
  const sum = [...push].map(d => d.split(",")).reduce((a, d) => [a[0] + +d[0], a[1] + +d[1]], [0, 0]);
  const length = Math.hypot(...sum) || 1;
  if (page.fitted) call("push", ...sum.map(s => 0.8 * world.gain * s / length));
  for (const button of $("pad").querySelectorAll("button")) button.classList.toggle("held", push.has(button.dataset.push));
}

// A few episodes a frame, so that the page stays alive.
function compare() {
  if (!page.fitted) return say("There is nothing to compare yet: draw a demonstration.");
  learnCertified();
  const tally = page.tally = world.methods.map(() => [0, 0, 0]);
  let slice = 0;
  const more = () => {
    if (page.tally !== tally) return;
    const begin = performance.now();
    while (performance.now() - begin < 12 && slice < 20 * tally.length) {
      const m = slice % tally.length;
      call("run", m, 5, 1000 + Math.floor(slice++ / tally.length));
      numbers(3).forEach((n, i) => tally[m][i] += n);
    }
    showTally();
    if (slice < 20 * tally.length) requestAnimationFrame(more);
  };
  more();
}

function showTally() {
  $("tally").hidden = !page.tally;
  if (!page.tally) return;
  $("tally").tBodies[0].innerHTML = page.tally.map(([done, halted, hit], m) =>
    `<tr><td>${METHODS[world.methods[m].name][0]}</td><td class="${done >= 90 ? "good" : ""}">${done}</td><td>${halted}</td>` +
    `<td class="${hit > 0 ? "bad" : ""}">${hit}</td></tr>`).join("");
}

// --- The picture --------------------------------------------------------------------------------

let colours = {};
function readColours() {
  const style = getComputedStyle(document.documentElement);
  for (const name of ["ink", "soft", "line", "demo", "red", "wall", "policy", "changed", "recovery", "halt", "support", "ring", "edge", "goal", "map", "card"]) {
    colours[name] = style.getPropertyValue("--" + name).trim();
  }
  page.paths = null;
  page.levels = null;
  page.dirty = true;
}

const colourOf = d => d.mode === HALT ? colours.halt : d.mode !== POLICY ? colours.recovery : d.changed ? colours.changed : colours.policy;

let width = 0, height = 0, scale = 1, dots = 1;
const X = x => scale * (x - VIEW.left), Y = y => scale * (VIEW.top - y);
function size() {
  dots = window.devicePixelRatio || 1;
  for (const canvas of [$("map"), $("strip")]) {
    canvas.width = Math.round(canvas.clientWidth * dots);
    canvas.height = Math.round(canvas.clientHeight * dots);
  }
  width = $("map").clientWidth;
  height = $("map").clientHeight;
  scale = width / (VIEW.right - VIEW.left);
  page.paths = null;
  page.levels = null;
  page.dirty = true;
}

function trace(path, points, from = 0, to = points.length) {
  for (let i = from; i < to; i += 2) i === from ? path.moveTo(X(points[i]), Y(points[i + 1])) : path.lineTo(X(points[i]), Y(points[i + 1]));
  return path;
}

function disc(c, [x, y, radius], fill, stroke, dash = []) {
  c.beginPath();
  c.arc(X(x), Y(y), Math.max(0.1, scale * radius), 0, 2 * Math.PI);
  if (fill) { c.fillStyle = fill; c.fill(); }
  if (stroke) { c.strokeStyle = stroke; c.setLineDash(dash); c.stroke(); c.setLineDash([]); }
}

// What does not move, drawn once a scene: obstacles, start, goal, demonstrations.
function still() {
  const picture = document.createElement("canvas");
  picture.width = $("map").width;
  picture.height = $("map").height;
  const c = picture.getContext("2d"), s = scene();
  c.scale(dots, dots);
  c.fillStyle = colours.map;
  c.fillRect(0, 0, width, height);
  c.lineWidth = 1.5;
  for (const d of s.discs) disc(c, d, colours.wall, colours.red);
  c.fillStyle = colours.wall;
  c.strokeStyle = colours.red;
  for (const [low, high] of s.boxes) {
    c.fillRect(X(low[0]), Y(high[1]), scale * (high[0] - low[0]), scale * (high[1] - low[1]));
    c.strokeRect(X(low[0]), Y(high[1]), scale * (high[0] - low[0]), scale * (high[1] - low[1]));
  }
  s.walls.forEach((wall, i) => {
    if (!wall.length) return;
    const path = trace(new Path2D(), wall.flat()), area = new Path2D(path), edge = i === 0 ? -9 : height + 9;
    c.stroke(path);
    area.lineTo(X(wall[wall.length - 1][0]), edge);
    area.lineTo(X(wall[0][0]), edge);
    c.fill(area);
  });
  disc(c, s.start, null, colours.soft, [3, 3]);
  disc(c, s.goal, null, colours.goal);
  c.font = "600 12px system-ui, sans-serif";
  c.textAlign = "center";
  c.fillStyle = colours.soft;
  c.fillText("start", X(s.start[0]), Y(s.start[1] - s.start[2]) + 15);
  c.fillStyle = colours.goal;
  c.fillText("goal", X(s.goal[0]), Y(s.goal[1] - s.goal[2]) + 15);
  c.strokeStyle = colours.demo;
  c.lineWidth = 1;
  c.lineJoin = "round";
  for (const d of page.demonstrations) c.stroke(trace(new Path2D(), d));
  return picture;
}

// l_t over the picture, and of it the shade and the rings.
function support_picture(t) {
  const columns = Math.ceil(width / CELL) + 1, rows = Math.ceil(height / CELL) + 1;
  call("levels", support(), t, VIEW.left, VIEW.top, CELL / scale, columns, rows);
  const values = numbers(columns * rows);
  let most = 1e-9;
  for (const v of values) if (v > most) most = v;
  const image = new ImageData(columns, rows), [red, green, blue] = colours.support.split(",").map(Number);
  for (let i = 0; i < values.length; ++i) {
    const v = values[i];
    image.data[4 * i] = red; image.data[4 * i + 1] = green; image.data[4 * i + 2] = blue;
    image.data[4 * i + 3] = v > 0 ? 62 + 110 * Math.min(1, v / most) : Math.max(0, 26 + 26 * v);
  }
  const shade = document.createElement("canvas");
  shade.width = columns;
  shade.height = rows;
  shade.getContext("2d").putImageData(image, 0, 0);
  const rings = new Path2D();
  for (const at of [-2, -1, -.5, .25 * most, .5 * most, .75 * most]) contour(rings, values, columns, rows, at);
  const edge = new Path2D();
  contour(edge, values, columns, rows, 0);
  return {t, shade, rings, edge, columns, rows};
}

// Marching squares: the line on which the values are `at`.
function contour(path, values, columns, rows, at) {
  for (let r = 0; r + 1 < rows; ++r) {
    for (let k = 0; k + 1 < columns; ++k) {
      const i = r * columns + k;
      const a = values[i] - at, b = values[i + 1] - at, d = values[i + columns + 1] - at, e = values[i + columns] - at;
      const code = (a > 0) + 2 * (b > 0) + 4 * (d > 0) + 8 * (e > 0);
      if (code === 0 || code === 15) continue;
      const cut = [];
      if (a > 0 !== b > 0) cut.push(k + a / (a - b), r);
      if (b > 0 !== d > 0) cut.push(k + 1, r + b / (b - d));
      if (e > 0 !== d > 0) cut.push(k + e / (e - d), r + 1);
      if (a > 0 !== e > 0) cut.push(k, r + a / (a - e));
      for (let j = 0; j + 3 < cut.length; j += 4) {
        path.moveTo(cut[j] * CELL, cut[j + 1] * CELL);
        path.lineTo(cut[j + 2] * CELL, cut[j + 3] * CELL);
      }
    }
  }
}

function arrow(c, [x, y], [tx, ty], colour, times) {
  const ax = X(x), ay = Y(y), dx = times * (X(tx) - ax), dy = times * (Y(ty) - ay), length = Math.hypot(dx, dy);
  if (length < 2) return;
  const bx = ax + dx, by = ay + dy, ux = dx / length, uy = dy / length;
  c.strokeStyle = c.fillStyle = colour;
  c.lineWidth = 2.5;
  c.beginPath(); c.moveTo(ax, ay); c.lineTo(bx - 6 * ux, by - 6 * uy); c.stroke();
  c.beginPath(); c.moveTo(bx, by); c.lineTo(bx - 10 * ux - 5 * uy, by - 10 * uy + 5 * ux); c.lineTo(bx - 10 * ux + 5 * uy, by - 10 * uy - 5 * ux); c.fill();
}

function ended(c, points, outcome) {
  const x = X(points[points.length - 2]), y = Y(points[points.length - 1]);
  c.lineWidth = 3;
  if (outcome === 2) {
    c.strokeStyle = colours.red;
    c.beginPath(); c.moveTo(x - 6, y - 6); c.lineTo(x + 6, y + 6); c.moveTo(x + 6, y - 6); c.lineTo(x - 6, y + 6); c.stroke();
  } else if (outcome === 1) {
    c.fillStyle = colours.soft;
    c.fillRect(x - 5, y - 5, 10, 10);
  }
}

function draw() {
  const c = $("map").getContext("2d");
  c.setTransform(dots, 0, 0, dots, 0, 0);
  page.paths ||= still();
  c.drawImage(page.paths, 0, 0, width, height);
  const last = page.history.length - 1, past = page.at < last;
  const seen = page.history[page.at];
  const t = past ? seen.t : page.phase;
  if (page.fitted) {
    if (!page.levels || page.levels.t !== t) page.levels = support_picture(t);
    const p = page.levels;
    c.drawImage(p.shade, -CELL / 2, -CELL / 2, p.columns * CELL, p.rows * CELL);
    c.lineWidth = 1;
    c.strokeStyle = colours.ring;
    c.stroke(p.rings);
    c.lineWidth = 2;
    c.strokeStyle = colours.edge;
    c.stroke(p.edge);
  }
  c.lineCap = "round";
  if (page.alone && page.method !== 0) {
    c.strokeStyle = colours.red;
    c.lineWidth = 1.6;
    c.setLineDash([2, 6]);
    c.stroke(trace(new Path2D(), page.alone.points));
    c.setLineDash([]);
    ended(c, page.alone.points, page.alone.outcome);
  }
  if (page.preview && $("show-preview").checked && !past) {
    c.strokeStyle = page.method === 0 ? colours.policy : colours.changed;
    c.lineWidth = 2;
    c.setLineDash([7, 6]);
    c.stroke(trace(new Path2D(), page.preview.points));
    c.setLineDash([]);
    ended(c, page.preview.points, page.preview.outcome);
  }
  c.lineWidth = 3;
  for (let i = 0; i <= page.at && i <= last; ++i) {
    const d = page.history[i], moving = i === last && !past ? page.share : 1;
    c.strokeStyle = colourOf(d);
    c.beginPath();
    c.moveTo(X(d.from[0]), Y(d.from[1]));
    c.lineTo(X(d.from[0] + moving * (d.to[0] - d.from[0])), Y(d.from[1] + moving * (d.to[1] - d.from[1])));
    c.stroke();
  }
  const state = past ? seen : page.now;
  const at = past ? seen.from : last >= 0 && page.share < 1 ?
    [0, 1].map(i => page.history[last].from[i] + page.share * (page.history[last].to[i] - page.history[last].from[i])) : page.robot;
  if (page.fitted && state && $("show-certificate").checked && state.radius > 0) {
    c.lineWidth = 1.8;
    disc(c, [...state.centre, state.radius], null, colours.edge, [5, 4]);
  }
  if (page.outcome === 2 && !past) ended(c, page.robot, 2);
  const decided = page.history[past ? page.at : last];
  if (decided && (page.running || past)) {
    arrow(c, at, [at[0] + decided.wanted[0] - decided.from[0], at[1] + decided.wanted[1] - decided.from[1]], colours.policy, 3.2);
    if (decided.changed || decided.mode !== POLICY) arrow(c, at, [at[0] + decided.to[0] - decided.from[0], at[1] + decided.to[1] - decided.from[1]], colourOf(decided), 3.2);
  }
  c.beginPath();
  c.arc(X(at[0]), Y(at[1]), 8, 0, 2 * Math.PI);
  c.fillStyle = colours.ink;
  c.fill();
  c.lineWidth = 2;
  c.strokeStyle = colours.map;
  c.stroke();
  if (page.line) {
    c.strokeStyle = colours.policy;
    c.lineWidth = 3;
    c.stroke(trace(new Path2D(), page.line));
  }
  if (page.pen) disc(c, [...page.pen, 0.03], colours.policy, null);
}

function drawStrip() {
  const c = $("strip").getContext("2d"), w = $("strip").clientWidth, h = $("strip").clientHeight;
  c.setTransform(dots, 0, 0, dots, 0, 0);
  c.clearRect(0, 0, w, h);
  const values = page.history.map(d => Math.max(-2, d.l)), high = Math.max(.2, ...values), low = Math.min(-.4, ...values);
  const x = i => 10 + i * (w - 20) / Math.max(60, values.length - 1), y = v => h - 10 - (h - 30) * (v - low) / (high - low);
  c.fillStyle = `rgba(${colours.support}, .14)`;
  c.fillRect(0, 0, w, y(0));
  c.strokeStyle = colours.edge;
  c.lineWidth = 1.2;
  c.beginPath(); c.moveTo(0, y(0)); c.lineTo(w, y(0)); c.stroke();
  c.lineWidth = 2.2;
  for (let i = 1; i < values.length; ++i) {
    c.strokeStyle = colourOf(page.history[i - 1]);
    c.globalAlpha = i <= page.at ? 1 : .35;
    c.beginPath(); c.moveTo(x(i - 1), y(values[i - 1])); c.lineTo(x(i), y(values[i])); c.stroke();
  }
  c.globalAlpha = 1;
  if (values.length) {
    c.fillStyle = colours.ink;
    c.beginPath(); c.arc(x(page.at), y(values[page.at]), 4.5, 0, 2 * Math.PI); c.fill();
  }
  c.fillStyle = colours.soft;
  c.font = "12px system-ui, sans-serif";
  c.fillText("l(x), the logarithmic form of g(x), control by control: inside the support above the line", 10, 15);
}

const figure = v => v === undefined || Number.isNaN(v) ? "–" : Math.abs(v) >= 1000 || (v !== 0 && Math.abs(v) < 1e-3) ? v.toExponential(2) : v.toPrecision(4);
function showReadings() {
  const past = page.at < page.history.length - 1, d = page.history[page.at], state = past ? d : page.now;
  const rows = [];
  if (page.fitted && state) {
    rows.push(["time step t", past ? d.t : page.phase], ["g(x)", figure(state.g)], ["l(x)", figure(state.l)]);
    if (d && !Number.isNaN(d.threshold)) rows.push(["λ|u|, as last needed", figure(d.threshold)]);
    rows.push(["certified radius", !page.certified ? "not learned yet" : state.radius > 0 ? `${figure(Math.max(0, state.radius - Math.hypot(state.centre[0] - (past ? d.from : page.robot)[0], state.centre[1] - (past ? d.from : page.robot)[1])))}` : "none, outside"]);
    if (d) rows.push(["last control", d.mode === POLICY && d.changed ? "learned, changed" : MODES[d.mode]]);
  }
  $("readings").innerHTML = rows.map(([name, value]) => `<dt>${name}</dt><dd>${value}</dd>`).join("");
  const over = page.outcome >= 0 && !past;
  $("outcome").textContent = over ? OUTCOMES[page.outcome] + (page.outcome === 1 ? ": " + world.causes[page.cause] : "") : "";
  $("outcome").style.color = [colours.goal, colours.ink, colours.red][page.outcome] || "";
}

let before = 0;
function frame(now) {
  requestAnimationFrame(frame);
  const elapsed = Math.min(.1, (now - before) / 1000);
  before = now;
  if (page.running) {
    page.due += elapsed * +$("speed").value;
    while (page.running && page.due >= 1) { page.due -= 1; control(); }
    page.share = page.running ? page.due : 1;
    page.dirty = true;
  }
  if (!page.dirty) return;
  page.dirty = false;
  ++page.frames;
  draw();
  drawStrip();
  showReadings();
}

// --- Pointer and keyboard -------------------------------------------------------------------------

const place = event => {
  const box = $("map").getBoundingClientRect();
  return [VIEW.left + (event.clientX - box.left) / scale, VIEW.top - (event.clientY - box.top) / scale];
};
function listen() {
  const map = $("map");
  let held = false;
  map.onpointerdown = event => {
    held = true;
    if (event.isTrusted) map.setPointerCapture(event.pointerId);
    map.focus({preventScroll: true});
    event.preventDefault();
    if (page.tool === "draw") { page.line = place(event); page.dirty = true; } else drag(place(event));
  };
  map.onpointermove = event => {
    if (!held) return;
    if (page.tool === "draw") { page.line.push(...place(event)); page.dirty = true; } else drag(place(event));
  };
  map.onpointerup = map.onpointercancel = () => {
    if (held && page.tool === "draw") endLine();
    held = false;
  };
  let back = false;
  const lookBack = event => {
    if (!page.history.length) return;
    run(false);
    const box = $("strip").getBoundingClientRect(), longest = Math.max(60, page.history.length - 1);
    page.at = Math.max(0, Math.min(page.history.length - 1, Math.round((event.clientX - box.left - 10) / (box.width - 20) * longest)));
    page.dirty = true;
  };
  $("strip").onpointerdown = event => { back = true; lookBack(event); };
  $("strip").onpointermove = event => { if (back) lookBack(event); };
  addEventListener("pointerup", () => { back = false; });
  $("run").onclick = () => run(!page.running);
  $("step").onclick = () => { run(false); control(); page.share = 1; };
  $("again").onclick = () => { run(false); newStart(true); };
  $("compare").onclick = compare;
  $("prepared").onclick = () => openScene(page.scene);
  $("clear").onclick = () => { call("clear"); run(false); learn(); setTool("draw"); };
  $("show-certificate").onchange = $("show-preview").onchange = () => { page.dirty = true; };
  for (const button of $("pad").querySelectorAll("button")) {
    button.onpointerdown = event => { event.preventDefault(); pushes(button.dataset.push, true); };
    button.onpointerup = button.onpointerleave = button.onpointercancel = button.onblur = () => pushes(button.dataset.push, false);
    button.onkeydown = event => { if (event.key === "Enter" || event.key === " ") { event.preventDefault(); event.stopPropagation(); pushes(button.dataset.push, true); } };
    button.onkeyup = () => pushes(button.dataset.push, false);
  }
  const ARROWS = {ArrowLeft: "-1,0", ArrowRight: "1,0", ArrowUp: "0,1", ArrowDown: "0,-1"};
  addEventListener("keydown", event => {
    const typing = event.target.matches("input[type=number], input[type=range]"), group = event.target.closest("[role=radiogroup]");
    if (typing || event.ctrlKey || event.metaKey || event.altKey) return;
    const direction = ARROWS[event.key];
    if (direction && group) {
      const buttons = [...group.children], step = direction === "1,0" || direction === "0,-1" ? 1 : -1;
      const next = buttons[(buttons.indexOf(event.target) + step + buttons.length) % buttons.length];
      next.focus();
      next.click();
    } else if (direction && page.tool === "draw") {
      page.pen ||= scene().start.slice(0, 2);
      page.line ||= [...page.pen];
      page.pen = page.pen.map((v, i) => v + .08 * +direction.split(",")[i]);
      page.line.push(...page.pen);
      page.dirty = true;
    } else if (direction && page.running) {
      pushes(direction, true);
    } else if (direction) {
      drag(page.robot.map((v, i) => v + .03 * +direction.split(",")[i]));
    } else if (event.key === "Enter" && page.tool === "draw" && page.line) {
      endLine();
    } else if (event.key === "Escape") {
      page.line = page.pen = null;
      page.dirty = true;
    } else if (event.key === " " && event.target.tagName !== "BUTTON" && event.target.type !== "checkbox" && event.target.tagName !== "SUMMARY") {
      run(!page.running);
    } else if (event.key === ".") {
      $("step").click();
    } else if (event.key === "r") {
      $("again").click();
    } else if (event.key === "m" || event.key === "d") {
      setTool(event.key === "m" ? "move" : "draw");
    } else if (event.key >= "1" && event.key <= String(world.methods.length)) {
      setMethod(+event.key - 1);
    } else {
      return;
    }
    event.preventDefault();
  });
  addEventListener("keyup", event => { if (ARROWS[event.key]) pushes(ARROWS[event.key], false); });
  addEventListener("blur", () => [...push].forEach(d => pushes(d, false)));
  new ResizeObserver(size).observe(map);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", readColours);
}

function choices(group, labels, pick) {
  for (const [i, label] of labels.entries()) {
    const button = document.createElement("button");
    button.setAttribute("role", "radio");
    button.innerHTML = label;
    button.onclick = () => pick(i);
    $(group).append(button);
  }
}

const ready = createKernel().then(made => {
  kernel = made;
  world = JSON.parse(kernel.UTF8ToString(kernel._page_describe()));
  choices("scenes", world.scenes.map(s => s.name), i => { run(false); openScene(i); });
  choices("methods", world.methods.map((m, i) => `${METHODS[m.name][0]} <kbd>${i + 1}</kbd>`), setMethod);
  [...$("tools").children].forEach(button => button.onclick = () => setTool(button.dataset.tool));
  readColours();
  size();
  listen();
  setMethod(page.method);
  openScene(0);
  requestAnimationFrame(frame);
}).catch(error => say(`This page needs a browser with WebAssembly, its SIMD and its exceptions: ${error.message || error}`));
