"use strict";
let state = null, beeped = 0, trace = [];

// vectors and rotations (rows of a matrix)
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const scale = (a, k) => a.map((v) => v * k);
const norm = (a) => scale(a, 1 / (Math.hypot(...a) || 1));
const apply = (m, v) => m.map((row) => dot(row, v));
const times = (m, n) => m.map((row) => [0, 1, 2].map((j) => row[0] * n[0][j] + row[1] * n[1][j] + row[2] * n[2][j]));
function turn(axis, angle) {
  const [x, y, z] = norm(axis), c = Math.cos(angle), s = Math.sin(angle), d = 1 - c;
  return [[c + x * x * d, x * y * d - z * s, x * z * d + y * s], [y * x * d + z * s, c + y * y * d, y * z * d - x * s],
    [z * x * d - y * s, z * y * d + x * s, c + z * z * d]];
}
// the rotation that takes the direction `up` of the sensor to the vertical
function upright(up) {
  const axis = cross(up, [0, 0, 1]), angle = Math.atan2(Math.hypot(...axis), up[2]);
  return Math.hypot(...axis) < 1e-6 ? turn([1, 0, 0], angle) : turn(axis, angle);
}
// seen from the front, a little above and from the side
const VIEW = times(turn([1, 0, 0], -1.2), turn([0, 0, 1], -2.2));

function screen(canvas, v, size) {
  const [x, y, z] = apply(VIEW, v);
  return [canvas.width / 2 + size * x, canvas.height / 2 - size * y, z];
}
const CORNERS = [-1, 1].flatMap((x) => [-1, 1].flatMap((y) => [-1, 1].map((z) => [0.95 * x, 0.65 * y, 0.22 * z])));
const FACES = [[[0, 0, 1], "z"], [[0, 0, -1], ""], [[1, 0, 0], "x"], [[-1, 0, 0], ""], [[0, 1, 0], "y"], [[0, -1, 0], ""]];

function drawBox(now) {
  const canvas = $("box"), pen = canvas.getContext("2d");
  pen.clearRect(0, 0, canvas.width, canvas.height);
  if (!state || !state.up) return;
  let rotation = upright(norm(state.up));
  if (state.target && state.phase !== "first rest") {
    const from = norm(state.up), to = norm(state.target);
    let axis = cross(to, from);
    const angle = Math.atan2(Math.hypot(...axis), dot(from, to));
    if (Math.hypot(...axis) < 1e-3) axis = cross(from, Math.abs(from[0]) < 0.7 ? [1, 0, 0] : [0, 1, 0]);
    const calm = matchMedia("(prefers-reduced-motion: reduce)").matches;
    const share = calm ? 1 : Math.min(1, Math.max(0, ((now / 1000) % 3) / 1.8));
    rotation = times(rotation, turn(axis, angle * (share * share * (3 - 2 * share))));
  }
  const view = times(VIEW, rotation), size = 150; // axes of any attitude stay inside
  const faces = FACES.map(([normal, name]) => {
    const axis = normal.findIndex((v) => v !== 0);
    const corners = CORNERS.filter((c) => c[axis] * normal[axis] > 0);
    const middle = scale(corners.reduce((a, c) => [a[0] + c[0], a[1] + c[1], a[2] + c[2]], [0, 0, 0]), 0.25);
    const side = norm(corners[0].map((v, k) => v - middle[k])), other = cross(normal, side);
    corners.sort((a, b) => Math.atan2(dot(a, other), dot(a, side)) - Math.atan2(dot(b, other), dot(b, side)));
    return { corners, middle, name, depth: apply(view, normal)[2] };
  }).filter((face) => face.depth > 0);
  const at = (v) => { const p = apply(view, v); return [canvas.width / 2 + size * p[0], canvas.height / 2 - size * p[1]]; };
  const drawAxes = (front) => ["x", "y", "z"].forEach((name, k) => {
    if ((apply(view, [0, 1, 2].map((j) => +(j === k)))[2] > 0) !== front) return;
    const tip = [0, 0, 0], foot = [0, 0, 0];
    foot[k] = [0.95, 0.65, 0.22][k]; tip[k] = foot[k] + 0.45;
    pen.strokeStyle = pen.fillStyle = colour(name);
    pen.lineWidth = 5;
    pen.beginPath(); pen.moveTo(...at(foot)); pen.lineTo(...at(tip)); pen.stroke();
    pen.font = "bold 30px sans-serif";
    tip[k] += 0.13;
    const [x, y] = at(tip);
    pen.fillText("+" + name, x - 14, y + 10);
  });
  drawAxes(false);
  for (const face of faces) {
    pen.beginPath();
    face.corners.forEach((c, k) => (k ? pen.lineTo(...at(c)) : pen.moveTo(...at(c))));
    pen.closePath();
    pen.fillStyle = face.name === "z" ? colour("warm") : colour("line");
    pen.globalAlpha = 0.35 + 0.5 * face.depth;
    pen.fill();
    pen.globalAlpha = 1;
    pen.strokeStyle = colour("ink");
    pen.lineWidth = 2;
    pen.stroke();
  }
  drawAxes(true);
}

function drawSphere() {
  const canvas = $("sphere"), pen = canvas.getContext("2d"), size = 200;
  pen.clearRect(0, 0, canvas.width, canvas.height);
  pen.strokeStyle = colour("line");
  pen.lineWidth = 2;
  for (const axis of [[1, 0, 0], [0, 1, 0], [0, 0, 1]]) {
    const a = norm(cross(axis, [0.3, 0.5, 0.8])), b = cross(axis, a);
    pen.beginPath();
    for (let k = 0; k <= 60; k++) {
      const t = (k / 60) * 2 * Math.PI, p = [0, 1, 2].map((i) => a[i] * Math.cos(t) + b[i] * Math.sin(t));
      const [x, y] = screen(canvas, p, size);
      if (k) pen.lineTo(x, y); else pen.moveTo(x, y);
    }
    pen.stroke();
  }
  pen.font = "24px sans-serif";
  for (const [k, name] of ["x", "y", "z"].entries()) {
    const v = [0, 0, 0];
    v[k] = 1.12;
    const [x, y] = screen(canvas, v, size);
    pen.fillStyle = colour(name);
    pen.fillText("+" + name, x - 12, y + 8);
  }
  if (!state) return;
  const spot = (v, radius, fill, ring) => {
    const [x, y, z] = screen(canvas, norm(v), size);
    pen.globalAlpha = z > 0 ? 1 : 0.35;
    pen.beginPath();
    pen.arc(x, y, radius, 0, 2 * Math.PI);
    if (fill) { pen.fillStyle = fill; pen.fill(); }
    if (ring) { pen.strokeStyle = ring; pen.lineWidth = 5; pen.stroke(); }
    pen.globalAlpha = 1;
  };
  for (const rest of state.rests) spot(rest, 10, colour("own"));
  if (state.target) spot(state.target, 18, null, colour("warm"));
  if (state.up) spot(state.up, 8, colour("ink"));
}

function drawTrace() {
  const canvas = $("trace"), pen = canvas.getContext("2d");
  pen.clearRect(0, 0, canvas.width, canvas.height);
  if (trace.length < 2) return;
  const last = trace[trace.length - 1][0], span = 8;
  for (const [part, first] of [1, 4].entries()) {
    const most = Math.max(1e-9, ...trace.flatMap((row) => [0, 1, 2].map((k) => Math.abs(row[first + k]))));
    const half = canvas.height / 4, middle = half * (1 + 2 * part);
    for (const [k, name] of ["x", "y", "z"].entries()) {
      pen.strokeStyle = colour(name);
      pen.lineWidth = 2;
      pen.beginPath();
      let down = false;
      for (const row of trace) {
        const x = canvas.width * (1 - (last - row[0]) / span), y = middle - (0.9 * half * row[first + k]) / most;
        if (x < 0) continue;
        if (down) pen.lineTo(x, y); else pen.moveTo(x, y);
        down = true;
      }
      pen.stroke();
    }
  }
}

function showBars(bars) {
  $("none").hidden = bars.length > 0;
  $("bars").tBodies[0].replaceChildren(...bars.map(([name, ratio]) => {
    const row = document.createElement("tr"), head = document.createElement("th"), bar = document.createElement("td");
    const meter = document.createElement("meter"), number = document.createElement("td");
    head.scope = "row"; head.textContent = name;
    bar.className = "bar"; number.className = "number";
    // full and green where the need is met, on a logarithmic scale before that
    meter.min = 0; meter.max = 1; meter.low = 0.6; meter.high = 0.99; meter.optimum = 1;
    meter.value = Math.min(1, Math.max(0.03, 1 - Math.log10(Math.max(ratio, 1)) / 2));
    meter.setAttribute("aria-label", name);
    number.textContent = ratio <= 1 ? `${ratio.toPrecision(2)} \u2713` : ratio.toPrecision(2);
    row.className = ratio <= 1 ? "met" : "";
    bar.append(meter);
    row.append(head, bar, number);
    return row;
  }));
}

function show(next) {
  if (next.rests.length > beeped) beep(next.confirmed ? 1320 : 880);
  beeped = next.rests.length;
  state = next;
  $("hold").value = Math.min(1, next.still_s / next.hold_s);
  showBars(next.bars);
  drawSphere();
  $("attitude").hidden = !next.counts; // of noise nothing is counted, of a field directions
  $("known").hidden = next.counts !== "rest";
  $("field").hidden = next.counts !== "direction";
  $("counted").textContent = `${next.counts}s`;
  return next.counts && counted(next.rests.length, next.counts);
}

follow(show).addEventListener("trace", (event) => { trace = [...trace, ...JSON.parse(event.data)].slice(-600); drawTrace(); });
(function frame(now) { drawBox(now); requestAnimationFrame(frame); })(performance.now());
