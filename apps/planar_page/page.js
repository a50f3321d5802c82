"use strict";
// Draws the libraries' results, and passes on the user's input. Computes no results itself.
const $ = id => document.getElementById(id);
const VIEW = {left: -0.4, right: 4.4, bottom: -1.15, top: 1.15};
const CELL = 9;  // pixels between the points at which the support is evaluated
const POLICY = 0, PROBE = 1, RECOVERY = 2, HALT = 3;
const MODES = ["learned", "probe", "recovery", "halted"];
const OUTCOMES = ["completed", "halted", "collided"];
const METHODS = {
  "baseline": ["The policy alone", "The learned policy acts unguarded."],
  "early-stopping": ["Early stopping", "Halts where the next control could leave the support: g ≤ λ|u|."],
  "dfr": ["DFR, as published", "Where g ≤ λ|u|, small random probes determine the direction in which g rises."],
  "controller": ["Controller", "Guided recovery: every applied control improves the estimate of the robot's response. The policy's control is changed as little as possible."],
  "certified-direction": ["Certified", "A control passes only if the state that it leads to is provably inside the support."],
};

let kernel, world;  // the libraries; their scenes and methods
const call = (name, ...args) => {
  const result = kernel["_page_" + name](...args);
  if (result === -1) throw new Error(kernel.UTF8ToString(kernel._page_error()));
  return result;
};
// View of the shared array, which may have moved since the last call.
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

// --- Requests of the user ---------------------------------------------------------------------

function openScene(index, count = 60) {
  page.scene = index;
  call("open", index);
  page.line = null;
  say("");
  if (scene().routes > 0) call("demonstrate", count, 1);
  page.seed = 1;
  learn();
  // Tries up to 20 start states to find one from which the policy alone does not complete.
  while (page.alone && page.alone.outcome === 0 && page.seed < 20) newStart(true);
  setTool(scene().routes > 0 ? "move" : "draw");
  chosen("scenes", index);
  $("summary").textContent = scene().summary;
  $("prepared").disabled = scene().routes === 0;
}

// Fits to the present demonstrations and begins an episode.
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

// Fits the certificates. Takes as long as all other fits, so the page shows their results first.
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
    count === 0 ? "None yet. Draw a line from start to goal." : `${count} so far; the policy needs at least three.`;
}

// Returns the mean duration of a decision of the controller, in microseconds.
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

// Begins an episode from `point` at time step `phase`.
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

// Applies one control and records it with the values behind the decision.
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

// Returns l, g and the certified disc at a point.
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

// Updates the readings and the preview of the present state.
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

// Moves the robot: begins a new episode there, or disturbs the running one.
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

// Runs a few episodes per frame, to keep the page responsive.
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
