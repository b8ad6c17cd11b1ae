"use strict";
const picture = new Image();
let state = null, asked = "";

const PLACES = {
  "upper left": [0, 0], upper: [1, 0], "upper right": [2, 0], left: [0, 1], middle: [1, 1], right: [2, 1],
  "lower left": [0, 2], lower: [1, 2], "lower right": [2, 2],
};

function draw() {
  if (!state) return;
  const canvas = $("view"), pen = canvas.getContext("2d"), [width, height] = state.size;
  canvas.height = Math.round((canvas.width * height) / width);
  if (picture.complete && picture.naturalWidth) pen.drawImage(picture, 0, 0, canvas.width, canvas.height);
  const rows = state.cells.length, columns = state.cells[0].length;
  const wide = canvas.width / columns, high = canvas.height / rows;
  pen.fillStyle = colour("good");
  pen.globalAlpha = 0.22;
  state.cells.forEach((row, j) => row.forEach((count, i) => {
    if (count) pen.fillRect(i * wide + 1, j * high + 1, wide - 2, high - 2);
  }));
  pen.globalAlpha = 1;
  if (state.region) {
    const [i, j] = PLACES[state.region];
    pen.strokeStyle = colour("warm");
    pen.lineWidth = 6;
    pen.setLineDash([18, 12]);
    pen.strokeRect((i * canvas.width) / 3 + 5, (j * canvas.height) / 3 + 5, canvas.width / 3 - 10, canvas.height / 3 - 10);
    pen.setLineDash([]);
  }
  pen.fillStyle = colour("own");
  for (const [x, y] of state.corners) {
    pen.beginPath();
    pen.arc(((x + 0.5) * canvas.width) / width, ((y + 0.5) * canvas.height) / height, 3, 0, 2 * Math.PI);
    pen.fill();
  }
  const share = state.cells.flat().filter(Boolean).length / (rows * columns);
  canvas.setAttribute("aria-label", `what the camera sees: ${state.corners.length} corners found, ` +
    `${Math.round(100 * share)} % of the image covered` + (state.region ? `, the board is wanted ${state.region}` : ""));
}

function showLights(lights) {
  $("lights").replaceChildren(...lights.map(([name, value, good]) => Object.assign(document.createElement("li"),
    { className: good ? "good" : "bad", textContent: `${good ? "\u2713" : "\u2717"} ${name}: ${value}` })));
}

function showBars(bars) {
  $("bars").tBodies[0].replaceChildren(...bars.map(([name, share]) => {
    const row = document.createElement("tr"), head = document.createElement("th"), bar = document.createElement("td");
    const meter = document.createElement("meter"), number = document.createElement("td");
    head.scope = "row"; head.textContent = name;
    bar.className = "bar"; number.className = "number";
    meter.min = 0; meter.max = 1; meter.low = 0.6; meter.high = 0.99; meter.optimum = 1;
    meter.value = Math.min(1, share);
    meter.setAttribute("aria-label", name);
    number.textContent = `${Math.round(100 * Math.min(1, share))} %` + (share >= 1 ? " \u2713" : "");
    row.className = share >= 1 ? "met" : "";
    bar.append(meter);
    row.append(head, bar, number);
    return row;
  }));
}

function show(next) {
  if (state && next.phase + next.region !== state.phase + state.region) beep(next.confirmed ? 1320 : 880);
  state = next;
  if (next.picture && next.picture !== asked) picture.src = `picture?at=${asked = next.picture}`;
  showLights(next.lights);
  showBars(next.bars);
  draw();
  return `${counted(next.written, "image")}, ${counted(next.views, "view")}`;
}

picture.onload = draw;
follow(show);
