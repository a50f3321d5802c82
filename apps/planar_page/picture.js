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

// Draws the parts that do not move: obstacles, start, goal, demonstrations.
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

// Evaluates l_t over the picture and makes its shade and contour lines.
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
