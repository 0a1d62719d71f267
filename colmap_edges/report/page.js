"use strict";
// Draws the 3D view and handles clicks and keys. Everything that needs no script (picture, charts,
// tables, images) is static in the page.

const TYPES = {f4: Float32Array, i4: Int32Array, u2: Uint16Array, u1: Uint8Array};
const LIFTED = 65535;
const MAX_CHOSEN_PICTURES = 8;
const MAX_CLICK_PX = 4;
const FULL = 4096;
const CONFIG = {responsive: true, displaylogo: false, displayModeBar: false};
const TURN = Math.PI / 24;
const KEYS = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1]};
const PARTS = {faces: ["outlines"]};  // traces that one switch shows with another
const INSTEAD_OF = {faces: "mesh", mesh: "faces"};  // they lie in one place and would flicker
const UNITS = {views: "views", residual: "px", length: "scene units"};
const NEARER = {"+": 0.85, "=": 0.85, "-": 1 / 0.85};

const byId = (id) => document.getElementById(id);

async function unpacked(id) {
  const bytes = Uint8Array.from(atob(byId(id).textContent), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(stream).arrayBuffer();
}

// Unpacks an array of packing.py: byte planes, integers as differences.
function decode(spec, bytes) {
  const Type = TYPES[spec.dtype];
  const size = Type.BYTES_PER_ELEMENT;
  const joined = new Uint8Array(spec.length * size);
  for (let plane = 0; plane < size; ++plane) {
    const from = spec.at + plane * spec.length;
    for (let i = 0; i < spec.length; ++i) joined[i * size + plane] = bytes[from + i];
  }
  const values = new Type(joined.buffer);
  if (Type !== Float32Array) for (let i = 1; i < values.length; ++i) values[i] += values[i - 1];
  return values;
}

function coordinates({steps, low, step}) {
  return Float32Array.from(steps, (value) => value === LIFTED ? NaN : low + value * step);
}

function colours(rgb) {
  const count = rgb.length / 3;
  const hex = (i) => ((rgb[i] << 16) | (rgb[count + i] << 8) | rgb[2 * count + i]);
  return Array.from({length: count}, (_, i) => `#${hex(i).toString(16).padStart(6, "0")}`);
}

function revived(node, bytes) {
  if (node === null || typeof node !== "object") return node;
  if (Array.isArray(node)) return node.map((each) => revived(each, bytes));
  if (node.dtype) return decode(node, bytes);
  const made = Object.fromEntries(Object.entries(node).map(([k, v]) => [k, revived(v, bytes)]));
  if (made.steps) return coordinates(made);
  return made.rgb ? colours(made.rgb) : made;
}

async function readData() {
  const buffer = await unpacked("data");
  const length = new DataView(buffer).getUint32(0, true);
  const text = new TextDecoder().decode(new Uint8Array(buffer, 4, length));
  return revived(JSON.parse(text), new Uint8Array(buffer, 4 + length));
}

async function loadPlotly() {
  const script = document.createElement("script");
  script.textContent = new TextDecoder().decode(await unpacked("plotly"));
  document.head.append(script);
}

function traceOf(name) {
  return data.scene.data.findIndex((trace) => trace.meta === name);
}

// The edge of every point of the edges' trace.
function edgesOfLine() {
  const owners = new Int32Array(edges.starts[edges.starts.length - 1]);
  for (let edge = 0; edge + 1 < edges.starts.length; ++edge) {
    owners.fill(edge, edges.starts[edge], edges.starts[edge + 1]);
  }
  return owners;
}

// The value of each edge that determines its colour.
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
  const by = byId("colour").value;
  const values = edgeValues(by);
  const [cmin, cmax] = colourRange(by, values);
  byId("scale").hidden = by === "edge";
  byId("least").textContent = Number(cmin.toPrecision(3));
  byId("most").textContent = `${Number(cmax.toPrecision(3))} ${UNITS[by] ?? ""}`;
  return Plotly.restyle(scene, {
    "line.color": [Array.from(lineEdges, (edge) => values[edge])],
    "line.cmin": cmin, "line.cmax": cmax,
    "line.colorscale": by === "edge" ? "Rainbow" : "Viridis",
  }, [traceOf("edges")]);
}

function chooseEdge(edge) {
  const line = data.scene.data[traceOf("edges")];
  const [first, last] = [edges.starts[edge], edges.starts[edge + 1]];
  const part = (axis) => Array.from(line[axis].subarray(first, last - 1));
  Plotly.restyle(scene, {x: [part("x")], y: [part("y")], z: [part("z")]}, [traceOf("chosen")]);
  const facts = [
    ["number", edge], ["points", edges.points[edge]], ["views", edges.views[edge]],
    ["length, scene units", edges.length[edge].toPrecision(4)],
    ["mean residual, px", edges.residual[edge].toFixed(3)],
  ];
  const table = document.createElement("table");
  for (const [name, value] of facts) {
    const row = table.insertRow();
    const head = document.createElement("th");
    head.scope = "row";
    head.textContent = name;
    row.append(head);
    row.insertCell().textContent = value;
  }
  byId("chosen").replaceChildren(table);
  byId("number").value = edge;
  showReprojections(edge);
}

function showReprojections(edge) {
  const pixels = new Map();
  for (let i = edges.track_offsets[edge]; i < edges.track_offsets[edge + 1]; ++i) {
    const picture = edges.track_pictures[i];
    if (!pixels.has(picture)) pixels.set(picture, []);
    pixels.get(picture).push([edges.track_x[i] / FULL, edges.track_y[i] / FULL]);
  }
  const best = [...pixels].sort((a, b) => b[1].length - a[1].length || a[0] - b[0]);
  const figures = best.slice(0, MAX_CHOSEN_PICTURES).map(([picture, points]) =>
    pictureWith(points, document.querySelector(`#pictures [data-picture="${picture}"]`)));
  byId("chosen-pictures").replaceChildren(...figures);
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
    pen.fillRect(x * canvas.width - size / 2, y * canvas.height - size / 2, size, size);
  }
  figure.querySelector(".stack").append(canvas);
  return figure;
}

// An edge is selected when the mouse is pressed and released at one position. (Plotly's click event
// requires the pointer to be too close to a point of the line.)
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

const plus = (a, b, times = 1) => ({x: a.x + times * b.x, y: a.y + times * b.y, z: a.z + times * b.z});
const dot = (a, b) => a.x * b.x + a.y * b.y + a.z * b.z;
const cross = (a, b) =>
  ({x: a.y * b.z - a.z * b.y, y: a.z * b.x - a.x * b.z, z: a.x * b.y - a.y * b.x});
const ZERO = {x: 0, y: 0, z: 0};
const scaled = (a, times) => plus(ZERO, a, times);
const unit = (a) => scaled(a, 1 / Math.max(Math.sqrt(dot(a, a)), 1e-12));

function rotated(a, axis, angle) {  // Rodrigues' formula
  const turned = plus(scaled(a, Math.cos(angle)), cross(axis, a), Math.sin(angle));
  return plus(turned, axis, dot(axis, a) * (1 - Math.cos(angle)));
}

function turnByKeys(event) {
  const {center, eye, up} = scene._fullLayout.scene.camera;
  let [arm, upwards] = [plus(eye, center, -1), unit(up)];
  if (KEYS[event.key]) {
    const [sideways, over] = KEYS[event.key];
    arm = rotated(arm, upwards, sideways * TURN);
    const right = unit(cross(upwards, arm));
    const tipped = rotated(arm, right, -over * TURN);
    if (Math.abs(dot(unit(tipped), upwards)) < 0.98) arm = tipped;
  } else if (NEARER[event.key]) {
    arm = scaled(arm, NEARER[event.key]);
  } else {
    return;
  }
  event.preventDefault();
  Plotly.relayout(scene, {"scene.camera": {center, up, eye: plus(center, arm)}});
}

// The first camera, moved back if the view is narrower than its intended aspect ratio.
function fitted(camera, aspect) {
  const back = Math.max(1, aspect * scene.clientHeight / scene.clientWidth);
  const arm = plus(camera.eye, camera.center, -1);
  return {...camera, eye: plus(camera.center, arm, back)};
}

// Print shows the current view.
function keepPictureForPrint() {
  let waiting = null;
  const first = byId("still").src;
  scene.on("plotly_relayout", () => {
    clearTimeout(waiting);
    waiting = setTimeout(async () => {
      byId("still").src = await Plotly.toImage(scene, {format: "jpeg", width: 1280, height: 800});
    }, 500);
  });
  byId("reset").addEventListener("click", async () => {
    await Plotly.relayout(scene, {"scene.camera": firstCamera});
    clearTimeout(waiting);
    byId("still").src = first;
  });
}

function addLayer(name) {
  const [index, label, box] = [traceOf(name), ...["label", "input"].map((n) => document.createElement(n))];
  if (index < 0) return;
  const shown = data.scene.data[index].visible !== false;
  [box.type, box.checked, box.id] = ["checkbox", shown, `layer-${name}`];
  const shownWith = [index, ...(PARTS[name] ?? []).map(traceOf)];
  box.addEventListener("change", () => {
    Plotly.restyle(scene, {visible: box.checked}, shownWith);
    const other = box.checked && byId(`layer-${INSTEAD_OF[name]}`);
    if (other && other.checked) other.click();
  });
  label.append(box, ` ${data.scene.data[index].name}`);
  byId("layers").append(label);
}

function bindLayer(name) {
  const box = byId(`show-${name}`);
  box.addEventListener("change", () =>
    byId("pictures").classList.toggle(`hide-${name}`, !box.checked));
  box.parentElement.hidden = !document.querySelector(`#pictures .${name}`);
}

let data, edges, lineEdges = [], firstCamera;
const scene = byId("view");

function bindEdges() {
  byId("colour").addEventListener("change", colourEdges);
  byId("number").max = edges.length.length - 1;
  byId("number").addEventListener("change", (event) => {
    const asked = event.target.valueAsNumber;
    if (Number.isInteger(asked) && asked >= 0 && asked < edges.length.length) chooseEdge(asked);
  });
  listenForClicks();
}

async function show3D() {
  data = await readData();
  edges = data.edges;
  firstCamera = fitted(data.scene.layout.scene.camera, data.scene.layout.meta.aspect);
  data.scene.layout.scene.camera = structuredClone(firstCamera);
  document.querySelectorAll(".of-edges").forEach((element) => { element.hidden = !edges; });
  byId("viewer").classList.toggle("alone", !edges);
  if (edges) {
    lineEdges = edgesOfLine();
    data.scene.data[traceOf("edges")].customdata = lineEdges;
  }
  ["edges", "mesh", "faces", "points", "cameras"].forEach(addLayer);
  byId("controls").hidden = false;
  await loadPlotly();
  await Plotly.newPlot(scene, data.scene.data, data.scene.layout, CONFIG);
  document.body.classList.add("drawn");
  scene.tabIndex = 0;
  scene.addEventListener("keydown", turnByKeys);
  byId("save").addEventListener("click", () =>
    Plotly.downloadImage(scene, {format: "png", width: 1920, height: 1200, filename: document.title}));
  keepPictureForPrint();
  if (!edges) return;
  bindEdges();
  await colourEdges();
  const asked = Number(/^#edge=(\d+)$/.exec(location.hash)?.[1] ?? NaN);
  if (asked < edges.length.length) chooseEdge(asked);
}

async function start() {
  byId("images").hidden = !document.querySelector("#pictures figure");
  byId("charts").hidden = !document.querySelector("#charts figure");
  ["detected", "dropped", "reprojected"].forEach(bindLayer);
  try {
    await show3D();
  } catch (error) {
    byId("controls").hidden = true;
    byId("trouble").hidden = false;
    byId("trouble").textContent = `This browser cannot show the scene in 3D (${error}).`;
  }
  document.body.dataset.ready = "1";
}

start();
