"use strict";
// Draws the figures and answers clicks; all it shows is in the element #data and the page.

const TYPES = {f4: Float32Array, i4: Int32Array, u2: Uint16Array};
const MAX_CHOSEN_PICTURES = 8;
const MAX_CLICK_PX = 4;
const CONFIG = {responsive: true, displaylogo: false};

function decode(spec) {
  const text = atob(spec.bdata);
  const bytes = Uint8Array.from(text, (letter) => letter.charCodeAt(0));
  return new TYPES[spec.dtype](bytes.buffer);
}

function decodeAll(specs) {
  return Object.fromEntries(Object.entries(specs).map(([name, spec]) => [name, decode(spec)]));
}

function traceOf(name) {
  return data.scene.data.findIndex((trace) => trace.meta === name);
}

// The value of each edge by which it is coloured.
function edgeValues(by) {
  if (by !== "edge") return Array.from(edges[by]);
  return Array.from(edges.length, (_, edge) => (edge * 0.618034) % 1);
}

function colourRange(by, values) {
  const sorted = values.filter(Number.isFinite).sort((a, b) => a - b);
  if (by === "edge" || sorted.length === 0) return [0, 1];
  const high = sorted[Math.floor(0.95 * (sorted.length - 1))];
  const low = by === "residual" ? 0 : sorted[0];
  return [low, high > low ? high : low + 1];
}

function colourEdges() {
  const select = document.getElementById("colour");
  const values = edgeValues(select.value);
  const [cmin, cmax] = colourRange(select.value, values);
  const colours = Array.from(lineEdges, (edge) => values[edge]);
  const title = select.selectedOptions[0].textContent;
  return Plotly.restyle(scene, {
    "line.color": [colours], "line.cmin": cmin, "line.cmax": cmax,
    "line.colorscale": select.value === "edge" ? "Rainbow" : "Viridis",
    "line.showscale": select.value !== "edge",
    "line.colorbar": [{title: {text: title}, thickness: 14, len: 0.6, x: 0.98, xanchor: "right"}],
  }, [traceOf("edges")]);
}

function chooseEdge(edge) {
  const [first, last] = [edges.starts[edge], edges.starts[edge + 1]];
  const part = (axis) => Array.from(line[axis].subarray(first, last - 1));
  Plotly.restyle(scene, {x: [part("x")], y: [part("y")], z: [part("z")]}, [traceOf("chosen")]);
  const facts = [
    ["id", edge], ["edge points", edges.points[edge]], ["views", edges.views[edge]],
    ["length, world units", edges.length[edge].toPrecision(4)],
    ["mean residual, px", edges.residual[edge].toFixed(3)],
  ];
  const table = document.createElement("table");
  for (const [name, value] of facts) {
    const row = table.insertRow();
    row.insertCell().textContent = name;
    row.insertCell().textContent = value;
  }
  document.getElementById("chosen").replaceChildren(table);
  showReprojections(edge);
}

function showReprojections(edge) {
  const pixels = new Map();
  for (let i = edges.track_offsets[edge]; i < edges.track_offsets[edge + 1]; ++i) {
    const picture = edges.track_pictures[i];
    if (!pixels.has(picture)) pixels.set(picture, []);
    pixels.get(picture).push([edges.track_pixels[2 * i], edges.track_pixels[2 * i + 1]]);
  }
  const best = [...pixels].sort((a, b) => b[1].length - a[1].length || a[0] - b[0]);
  const figures = best.slice(0, MAX_CHOSEN_PICTURES).map(([picture, points]) =>
    pictureWith(points, document.querySelector(`#pictures [data-picture="${picture}"]`)));
  document.getElementById("chosen-pictures").replaceChildren(...figures);
}

function pictureWith(points, original) {
  const figure = original.cloneNode(true);
  figure.querySelectorAll(".layer").forEach((layer) => layer.remove());
  const photo = original.querySelector(".photo");
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [photo.naturalWidth, photo.naturalHeight];
  const pen = canvas.getContext("2d");
  pen.fillStyle = "#ff00a8";
  const size = Math.max(canvas.width / 160, 3);
  for (const [x, y] of points) {
    pen.fillRect(x / 65535 * canvas.width - size / 2, y / 65535 * canvas.height - size / 2, size, size);
  }
  figure.querySelector(".stack").append(canvas);
  return figure;
}

// An edge is chosen where the mouse is pressed and let go in one place. (Plotly's own event for
// clicks needs the pointer to be nearer to a point of the line than a hand is.)
function listenForClicks() {
  let [under, pressed] = [null, null];
  const remember = (event) => {
    const point = event.points.find((p) => p.data.meta === "edges");
    under = point ? lineEdges[point.pointNumber] : null;
  };
  scene.on("plotly_hover", remember);
  scene.on("plotly_click", remember);
  scene.on("plotly_unhover", () => { under = pressed ? under : null; });
  scene.addEventListener("pointerdown", (event) => { pressed = event; }, true);
  window.addEventListener("pointerup", (event) => {
    const moved = pressed && Math.hypot(event.x - pressed.x, event.y - pressed.y);
    if (pressed && moved < MAX_CLICK_PX && under !== null) chooseEdge(under);
    pressed = null;
  }, true);
}

function bindLayer(name) {
  const box = document.getElementById(`show-${name}`);
  box.addEventListener("change", () =>
    document.getElementById("pictures").classList.toggle(`hide-${name}`, !box.checked));
}

const data = JSON.parse(document.getElementById("data").textContent);
const scene = document.getElementById("scene");
const edges = data.edges && decodeAll(data.edges);
const edgeTrace = data.scene.data[traceOf("edges")];
const lineEdges = edgeTrace ? decode(edgeTrace.customdata) : [];
const line = edgeTrace ? decodeAll({x: edgeTrace.x, y: edgeTrace.y, z: edgeTrace.z}) : {};

async function start() {
  for (const id of ["edge-controls", "side"]) document.getElementById(id).hidden = !edges;
  document.getElementById("images").hidden = !document.querySelector("#pictures figure");
  await Plotly.newPlot(scene, data.scene.data, data.scene.layout, CONFIG);
  if (edges && lineEdges.length) {
    await colourEdges();
    document.getElementById("colour").addEventListener("change", colourEdges);
    listenForClicks();
  }
  const places = data.charts.map(() => document.createElement("div"));
  document.getElementById("charts").append(...places);  // all, so that each has its width
  for (const [index, chart] of data.charts.entries()) {
    await Plotly.newPlot(places[index], chart.data, chart.layout, {...CONFIG, displayModeBar: false});
  }
  const asked = Number(/^#edge=(\d+)$/.exec(location.hash)?.[1] ?? NaN);
  if (edges && asked < edges.length.length) chooseEdge(asked);
  ["detected", "dropped", "reprojected"].forEach(bindLayer);
  document.body.dataset.ready = "1";
}

start();
