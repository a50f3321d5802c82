#include "apps/planar/page.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <fstream>
#include <nlohmann/json.hpp>
#include <set>
#include <stdexcept>
#include <vector>

#include "dfr/sim/planar/corridor.h"
#include "dfr/sim/planar/disc_push.h"

namespace dfr::apps::planar {
namespace {

using nlohmann::json;

constexpr std::string_view kHead = R"html(<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>TITLE</title>
<style>
body { font: 15px/1.45 system-ui, sans-serif; color: #28292b; background: #f7f7f5; margin: 0 auto; max-width: 1110px; padding: 14px 24px 90px; }
h1 { font-size: 22px; margin: 8px 0 4px; }
p { margin: 4px 0 12px; max-width: 62em; }
section { background: #fff; border: 1px solid #dcdcd8; border-radius: 6px; margin: 0 0 12px; overflow: hidden; width: max-content; }
section[hidden] { display: none; }
section header { padding: 5px 10px; display: flex; gap: 14px; }
canvas { display: block; }
footer { position: fixed; left: 0; right: 0; bottom: 0; background: #fffe; border-top: 1px solid #dcdcd8; padding: 10px 24px; display: flex; gap: 16px; align-items: center; flex-wrap: wrap; }
footer input[type=range] { flex: 1; min-width: 260px; }
button { font: inherit; min-width: 5em; }
i { font-style: normal; font-weight: 600; }
</style></head><body>
<h1>TITLE</h1>
<p>Shaded: the support at the present time step, with level sets; the dark line is its boundary g = 0. <i style="color:#cc3344">Red</i>: stay-out
regions, which no method knows. Grey: demonstrations. Ways: <i style="color:#0072b2">learned control</i>, <i style="color:#009e73">learned control,
changed</i>, <i style="color:#d55e00">recovery and probes</i>. Dashed: where the next control can lead. Recoveries of many controls are shown in part.</p>
<div id="panels"></div>
<footer><button id="play">Play</button><input id="time" type="range" min="0" value="0" autofocus><span id="methods"></span></footer>
<script>
const data = )html";

// Evaluates the supports itself, so that level sets are sharp at any size and the page stays small.
constexpr std::string_view kScript = R"js(;
"use strict";
const $ = id => document.getElementById(id);
const INK = "#28292b", BLUE = "#0072b2", GREEN = "#009e73", ORANGE = "#d55e00", RED = "#cc3344";
const SCALE = Math.min(1060, innerWidth - 60) / (data.view.right - data.view.left);
const WIDTH = Math.round(SCALE * (data.view.right - data.view.left));
const HEIGHT = Math.round(SCALE * (data.view.top - data.view.bottom));
const DOTS = window.devicePixelRatio || 1;
const CELL = 5;  // pixels between the nodes at which the support is evaluated
const px = (x, y) => [SCALE * (x - data.view.left), SCALE * (data.view.top - y)];
const colour = f => f.mode === "halt" ? INK : f.mode !== "policy" ? ORANGE : f.filtered ? GREEN : BLUE;
const word = f => f.mode === "policy" ? (f.filtered ? "learned control, changed" : "learned control") : f.mode;

// l_t at state x: log sum_i w_i exp(-gamma |A x + b - y_i|^2) - log rho, by the terms themselves.
function level(support, x) {
  const n = support.b.length, y = new Array(n);
  for (let i = 0; i < n; ++i) {
    y[i] = support.b[i];
    for (let j = 0; j < x.length; ++j) y[i] += support.A[i][j] * x[j];
  }
  let most = -Infinity;
  const e = support.y.map((p, k) => {
    let square = 0;
    for (let i = 0; i < n; ++i) square += (y[i] - p[i]) * (y[i] - p[i]);
    const value = support.w[k] - support.gamma * square;
    most = Math.max(most, value);
    return value;
  });
  let sum = 0;
  for (const value of e) sum += Math.exp(value - most);
  return most + Math.log(sum) - support.logRho;
}

// The level sets over the last two entries of the state, the others as they are.
function grid(support, x) {
  const cols = Math.ceil(WIDTH / CELL) + 1, rows = Math.ceil(HEIGHT / CELL) + 1;
  const values = new Float64Array(cols * rows), q = x.slice(), n = q.length;
  let largest = 1e-9;
  for (let r = 0; r < rows; ++r) {
    for (let c = 0; c < cols; ++c) {
      q[n - 2] = data.view.left + c * CELL / SCALE;
      q[n - 1] = data.view.top - r * CELL / SCALE;
      const l = level(support, q);
      values[r * cols + c] = l;
      if (l > largest) largest = l;
    }
  }
  return {values, cols, rows, largest};
}

// Marching squares: the line on which the values are `at`.
function contour(context, g, at) {
  context.beginPath();
  const v = (r, c) => g.values[r * g.cols + c] - at;
  for (let r = 0; r + 1 < g.rows; ++r) {
    for (let c = 0; c + 1 < g.cols; ++c) {
      const a = v(r, c), b = v(r, c + 1), d = v(r + 1, c + 1), e = v(r + 1, c), cut = [];
      if (a > 0 !== b > 0) cut.push([c + a / (a - b), r]);
      if (b > 0 !== d > 0) cut.push([c + 1, r + b / (b - d)]);
      if (e > 0 !== d > 0) cut.push([c + e / (e - d), r + 1]);
      if (a > 0 !== e > 0) cut.push([c, r + a / (a - e)]);
      for (let i = 0; i + 1 < cut.length; i += 2) {
        context.moveTo(cut[i][0] * CELL, cut[i][1] * CELL);
        context.lineTo(cut[i + 1][0] * CELL, cut[i + 1][1] * CELL);
      }
    }
  }
  context.stroke();
}

function shade(context, g) {
  const image = new ImageData(g.cols, g.rows);
  for (let i = 0; i < g.values.length; ++i) {
    const share = Math.min(1, Math.max(0, g.values[i] / g.largest));
    image.data.set([38, 120, 110, g.values[i] > 0 ? 60 + 110 * share : 0], 4 * i);
  }
  const small = document.createElement("canvas");
  small.width = g.cols; small.height = g.rows;
  small.getContext("2d").putImageData(image, 0, 0);
  context.imageSmoothingEnabled = true;
  context.drawImage(small, -CELL / 2, -CELL / 2, g.cols * CELL, g.rows * CELL);
}

function circle(context, x, y, radius, fill, stroke, width = 1.5) {
  context.beginPath();
  context.arc(...px(x, y), Math.max(0.1, SCALE * radius), 0, 2 * Math.PI);
  if (fill) { context.fillStyle = fill; context.fill(); }
  if (stroke) { context.strokeStyle = stroke; context.lineWidth = width; context.stroke(); }
}

function polyline(context, points, close) {
  context.beginPath();
  points.forEach((p, i) => i ? context.lineTo(...px(...p)) : context.moveTo(...px(...p)));
  if (close) context.closePath();
}

// What never moves, drawn once: stay-out regions, goal, demonstrations.
const scene = document.createElement("canvas");
scene.width = WIDTH * DOTS; scene.height = HEIGHT * DOTS;
{
  const context = scene.getContext("2d");
  context.scale(DOTS, DOTS);
  context.fillStyle = "#fff";
  context.fillRect(0, 0, WIDTH, HEIGHT);
  context.fillStyle = "#f6d5d6";
  for (const region of data.red.polygons) { polyline(context, region, true); context.fill(); }
  for (const c of data.red.circles) circle(context, c[0], c[1], c[2], "#e8959b", RED, 1);
  context.strokeStyle = "rgba(90,90,100,.16)";
  context.lineWidth = 1;
  for (const d of data.demonstrations) { polyline(context, d, false); context.stroke(); }
  context.strokeStyle = "#3a9a50";
  context.lineWidth = 2.5;
  if (data.goal.line) { polyline(context, data.goal.line, false); context.stroke(); }
  if (data.goal.circle) circle(context, ...data.goal.circle, null, "#3a9a50", 2.5);
}

const panels = data.methods.map(method => {
  const box = document.createElement("section");
  box.innerHTML = "<header><b></b><span></span></header><canvas></canvas><canvas></canvas>";
  box.querySelector("b").textContent = method.name;
  $("panels").append(box);
  const [map, strip] = box.querySelectorAll("canvas");
  for (const [canvas, height] of [[map, HEIGHT], [strip, 54]]) {
    canvas.width = WIDTH * DOTS; canvas.height = height * DOTS;
    canvas.style.width = WIDTH + "px"; canvas.style.height = height + "px";
    canvas.getContext("2d").scale(DOTS, DOTS);
  }
  const label = document.createElement("label"), tick = document.createElement("input");
  tick.type = "checkbox"; tick.checked = true;
  tick.onchange = () => { box.hidden = !tick.checked; show(); };
  label.append(tick, " " + method.name);
  $("methods").append(label);
  return {method, box, map: map.getContext("2d"), strip: strip.getContext("2d"), text: box.querySelector("span")};
});

function drawMap(p, now) {
  const frames = p.method.frames, f = frames[now], c = p.map, blocks = f.x.length / 2;
  c.drawImage(scene, 0, 0, WIDTH, HEIGHT);
  const support = data.supports[p.method.support][f.t];
  const g = grid(support, f.x);
  shade(c, g);
  c.strokeStyle = "rgba(255,255,255,.75)"; c.lineWidth = 1;
  for (const share of [.25, .5, .75]) contour(c, g, share * g.largest);
  c.strokeStyle = "#0f5a50"; c.lineWidth = 2;
  contour(c, g, 0);
  c.lineWidth = 2.2; c.lineCap = "round";
  for (let k = 0; k < now; ++k) {
    c.strokeStyle = colour(frames[k]);
    for (let b = 0; b < blocks; ++b) {
      polyline(c, [frames[k].x.slice(2 * b, 2 * b + 2), frames[k + 1].x.slice(2 * b, 2 * b + 2)], false);
      c.stroke();
    }
  }
  const [x, y] = f.x;
  if (data.disc) {
    circle(c, f.x[2], f.x[3], data.disc.object, "rgba(255,255,255,.55)", INK, 2);
    circle(c, x, y, data.disc.pusher, INK, null);
  } else {
    circle(c, x, y, 5 / SCALE, INK, null);
  }
  if (f.reach > 0) {
    c.setLineDash([4, 3]);
    circle(c, x, y, f.reach, null, colour(f), 1.8);
    c.setLineDash([]);
  }
}

function drawStrip(p, now) {
  const c = p.strip, frames = p.method.frames, values = frames.map(f => Math.max(f.l, -1));
  const high = Math.max(...values, .1), low = Math.min(...values, -.1);
  const at = i => 8 + i * (WIDTH - 16) / Math.max(1, frames.length - 1);
  const y = v => 48 - 42 * (v - low) / (high - low);
  c.clearRect(0, 0, WIDTH, 54);
  c.strokeStyle = "#c9cacd"; c.lineWidth = 1;
  c.beginPath(); c.moveTo(8, y(0)); c.lineTo(WIDTH - 8, y(0)); c.stroke();
  c.lineWidth = 2;
  for (let i = 1; i < frames.length; ++i) {
    c.strokeStyle = colour(frames[i - 1]);
    c.globalAlpha = i <= now ? 1 : .25;
    c.beginPath(); c.moveTo(at(i - 1), y(values[i - 1])); c.lineTo(at(i), y(values[i])); c.stroke();
  }
  c.globalAlpha = 1;
  c.fillStyle = colour(frames[now]);
  c.beginPath(); c.arc(at(now), y(values[now]), 4, 0, 2 * Math.PI); c.fill();
  c.fillStyle = "#777"; c.font = "11px sans-serif";
  c.fillText("l(x), 0 at the boundary", 10, 12);
}

const slider = $("time");
slider.max = Math.max(...data.methods.map(m => m.frames.length)) - 1;
function show() {
  for (const p of panels) {
    if (p.box.hidden) continue;
    const frames = p.method.frames, now = Math.min(+slider.value, frames.length - 1), f = frames[now];
    drawMap(p, now);
    drawStrip(p, now);
    const last = now === frames.length - 1;
    p.text.textContent = `control ${f.n}, t = ${f.t}: ` + (last ? p.method.outcome : word(f));
    p.text.style.color = last ? (p.method.outcome.startsWith("completed") ? GREEN : RED) : colour(f);
  }
  history.replaceState(null, "", "#" + slider.value);
}
let timer = null;
function play() {
  if (timer) { clearInterval(timer); timer = null; $("play").textContent = "Play"; return; }
  if (+slider.value >= +slider.max) slider.value = 0;
  $("play").textContent = "Pause";
  timer = setInterval(() => {
    if (+slider.value >= +slider.max) return play();
    slider.value = +slider.value + 1;
    show();
  }, 120);
}
slider.oninput = show;
$("play").onclick = play;
addEventListener("keydown", event => {
  if (event.target === slider) return;
  const step = {ArrowRight: 1, ArrowLeft: -1}[event.key];
  if (step) { slider.value = +slider.value + step; show(); }
});
slider.value = parseInt(location.hash.slice(1)) || 0;
show();
)js";

// Five decimals are more than a picture can show, and keep the page small.
double Short(double value) { return std::round(1e5 * value) / 1e5; }

json Point(double x, double y) { return {Short(x), Short(y)}; }

json Vector(std::span<const double> values) {
  json list = json::array();
  for (const double value : values) list.push_back(Short(value));
  return list;
}

// One estimate as l(x) = log sum_k exp(w_k - gamma |A x + b - y_k|^2) - log rho.
json Estimate(const kernel::OneClassSvm& svm, const core::Matrix& a, const Eigen::VectorXd& b) {
  json rows = json::array();
  for (Eigen::Index i = 0; i < a.rows(); ++i) rows.push_back(Vector(core::Row(a, i)));
  json points = json::array();
  for (Eigen::Index k = 0; k < svm.support_vectors().rows(); ++k) {
    points.push_back(Vector(core::Row(svm.support_vectors(), k)));
  }
  const Eigen::VectorXd log_alpha = svm.alpha().array().log();
  return {{"A", std::move(rows)},   {"b", Vector(core::AsSpan(b))},
          {"y", std::move(points)}, {"w", Vector(core::AsSpan(log_alpha))},
          {"gamma", svm.gamma()},   {"logRho", std::log(svm.rho())}};
}

json Estimate(const Methods& methods, SupportKind kind, int t) {
  if (kind == SupportKind::kRaw) {
    const kernel::OneClassSvm& svm = methods.raw_support().at(t);
    const int n = svm.state_dim();
    return Estimate(svm, core::Matrix::Identity(n, n), Eigen::VectorXd::Zero(n));
  }
  const core::FeatureTransform& features = methods.model(kind).features();
  const kernel::WhitenedSupport& support = methods.whitened_support(kind);
  const std::vector<double> zero(static_cast<std::size_t>(features.state_dim()));
  Eigen::VectorXd origin(features.num_features());
  features.Apply(zero, core::AsSpan(origin));
  const core::Matrix a = support.map(t) * features.scale();
  const Eigen::VectorXd b = support.map(t) * origin;
  return Estimate(support.estimate(t), a, b);
}

const char* Key(SupportKind kind) {
  return kind == SupportKind::kRaw ? "raw" : kind == SupportKind::kGuided ? "guided" : "certified";
}

// Which shots to show: all of the learned policy's, and of a recovery ever fewer.
std::vector<std::size_t> Chosen(const Episode& episode) {
  std::vector<std::size_t> chosen;
  std::size_t run = 0;
  std::size_t next = 0;
  for (std::size_t i = 0; i < episode.shots.size(); ++i) {
    const control::Mode mode = episode.shots[i].step.mode;
    const bool recovering = mode == control::Mode::kRecovery || mode == control::Mode::kProbe;
    run = recovering ? run + 1 : 0;
    if (run <= 1) next = 1;
    if (recovering && run < next) continue;
    next = std::max(run + 1, run * 5 / 4);
    chosen.push_back(i);
  }
  return chosen;
}

json Frames(const Task& task, const Methods& methods, const Episode& episode, SupportKind kind) {
  json frames = json::array();
  for (const std::size_t i : Chosen(episode)) {
    const Shot& shot = episode.shots[i];
    frames.push_back({{"n", i},
                      {"x", Vector(shot.x)},
                      {"t", shot.step.t},
                      {"l", Short(methods.Level(kind, shot.step.t, shot.x))},
                      {"mode", control::Name(shot.step.mode)},
                      {"filtered", shot.step.filtered},
                      {"reach", shot.u.empty() ? 0.0 : Short(Reach(task, shot.u))}});
  }
  return frames;
}

json Scene(const Task& task, json& data) {
  const View view = ViewOf(task);
  data["view"] = {
      {"left", view.left}, {"right", view.right}, {"bottom", view.bottom}, {"top", view.top}};
  json red = {{"polygons", json::array()}, {"circles", json::array()}};
  if (const auto* corridor = dynamic_cast<const sim::CorridorPlant*>(task.plant.get())) {
    // Beyond the edges of the picture, which cuts it off there.
    constexpr double kBeyond = 0.5;
    const double left = view.left - kBeyond;
    const double right = view.right + kBeyond;
    for (const double side : {1.0, -1.0}) {
      const double edge = side * (view.top + kBeyond);
      json wall = {Point(left, edge)};
      for (const auto& [x, y] : corridor->Wall(side, left, right)) wall.push_back(Point(x, y));
      wall.push_back(Point(right, edge));
      red["polygons"].push_back(std::move(wall));
    }
    const double goal = corridor->options().length;
    data["goal"]["line"] = {Point(goal, view.bottom), Point(goal, view.top)};
  } else {
    const auto& o = dynamic_cast<const sim::DiscPushPlant&>(*task.plant).options();
    for (const double side : {1.0, -1.0}) {
      red["circles"].push_back({o.gate_x, side * o.gate_y, o.red_radius});
    }
    data["goal"]["circle"] = {o.goal_x, 0.0, o.goal_radius};
    data["disc"] = {{"object", o.object_radius}, {"pusher", o.pusher_radius}};
  }
  return red;
}

}  // namespace

void WritePage(const Task& task, const Methods& methods, const std::vector<Episode>& episodes,
               const std::filesystem::path& path) {
  json data;
  data["red"] = Scene(task, data);
  for (const core::Trajectory& d : methods.demonstrations()) {
    const Eigen::Index first = d.states.cols() - 2;
    json way = json::array();
    for (Eigen::Index t = 0; t < d.states.rows(); ++t) {
      way.push_back(Point(d.states(t, first), d.states(t, first + 1)));
    }
    data["demonstrations"].push_back(std::move(way));
  }
  std::set<std::pair<SupportKind, int>> needed;
  for (const Episode& episode : episodes) {
    const SupportKind kind = SupportOf(episode.method);
    for (const std::size_t i : Chosen(episode)) needed.emplace(kind, episode.shots[i].step.t);
    data["methods"].push_back({{"name", episode.method},
                               {"support", Key(kind)},
                               {"outcome", std::string(core::Name(episode.outcome)) +
                                               (episode.cause.empty() ? "" : ", " + episode.cause)},
                               {"frames", Frames(task, methods, episode, kind)}});
  }
  for (const auto& [kind, t] : needed) {
    data["supports"][Key(kind)][std::to_string(t)] = Estimate(methods, kind, t);
  }

  std::string head(kHead);
  const std::string title = "Recovery in the plane: " + task.name;
  for (std::size_t at = head.find("TITLE"); at != std::string::npos; at = head.find("TITLE")) {
    head.replace(at, 5, title);
  }
  std::ofstream page(path);
  page << head << data.dump() << kScript << "</script></body></html>\n";
  page.close();
  if (!page) throw std::runtime_error(path.string() + ": the page cannot be written");
}

}  // namespace dfr::apps::planar
