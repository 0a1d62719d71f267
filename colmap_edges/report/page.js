"use strict";
// Draws the 3D view and handles clicks and keys. Everything that needs no script (picture, charts,
// tables, images) is static in the page.

const TYPES = {f4: Float32Array, i4: Int32Array, u2: Uint16Array, u1: Uint8Array};
const LIFTED = 65535;
const MAX_CHOSEN_PICTURES = 8;
const MAX_CLICK_PX = 4;
const FULL = 4096;
const PICK_PX = 8;  // how near to an edge a click may be
const FRONT_PX = 2;  // of edges that differ by less in distance, the front one is chosen
const FOV_DEG = 45;
const BACKGROUND = "#101418";
const CHOSEN = "#ff00a8";
const PICTURE = [1920, 1200];
const TURN = Math.PI / 24;
const KEYS = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1]};
const INSTEAD_OF = {faces: "mesh", mesh: "faces"};  // they lie in one place and would flicker
const UNITS = {views: "views", residual: "px", length: "scene units"};
const RAMP = ["#440154", "#3b528b", "#21918c", "#5ec962", "#fde725"];  // as #ramp in the page
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
  return Float64Array.from(steps, (value) => value === LIFTED ? NaN : low + value * step);
}

// Red, green and blue of every item, one after the other, as three.js wants them.
function colours(rgb) {
  const count = rgb.length / 3;
  return Uint8Array.from(rgb, (_, i) => rgb[(i % 3) * count + Math.floor(i / 3)]);
}

function revived(node, bytes) {
  if (node === null || typeof node !== "object") return node;
  if (Array.isArray(node)) return node.map((each) => revived(each, bytes));
  if (node.dtype) return decode(node, bytes);
  const made = Object.fromEntries(Object.entries(node).map(([k, v]) => [k, revived(v, bytes)]));
  if (made.steps) return coordinates(made);
  return made.rgb ? {...made, rgb: colours(made.rgb)} : made;
}

async function readData() {
  const buffer = await unpacked("data");
  const length = new DataView(buffer).getUint32(0, true);
  const text = new TextDecoder().decode(new Uint8Array(buffer, 4, length));
  return revived(JSON.parse(text), new Uint8Array(buffer, 4 + length));
}

async function loadThree() {
  const script = document.createElement("script");
  script.textContent = new TextDecoder().decode(await unpacked("three"));
  document.head.append(script);
}

// Positions of a layer relative to the origin, x, y and z of one point after the other.
function positions({x, y, z}) {
  const axes = [x, y, z];
  const [origin, made] = [data.scene.origin, new Float32Array(3 * x.length)];
  for (let i = 0; i < made.length; ++i) made[i] = axes[i % 3][Math.floor(i / 3)] - origin[i % 3];
  return made;
}

// Pairs of consecutive points as segments, without those that touch a lifted point.
function segmentsOf(points) {
  const rows = [];
  for (let row = 0; row + 1 < points.length / 3; ++row) {
    if (!Number.isNaN(points[3 * row]) && !Number.isNaN(points[3 * row + 3])) rows.push(row);
  }
  const made = new Float32Array(6 * rows.length);
  rows.forEach((row, i) => made.set(points.subarray(3 * row, 3 * row + 6), 6 * i));
  return [made, rows];
}

class View3D {
  constructor(canvas) {
    this.canvas = canvas;
    this.renderer = new THREE.WebGLRenderer({canvas, antialias: true, preserveDrawingBuffer: true});
    this.renderer.setPixelRatio(window.devicePixelRatio);
    this.renderer.setClearColor(BACKGROUND);
    this.scene = new THREE.Scene();
    this.camera = new THREE.PerspectiveCamera(FOV_DEG, 1, 1, 2);
    this.layers = {};
    this.pending = false;
    this.light();
    const {up} = data.scene.view;
    this.camera.up.set(...up);
    this.controls = new THREE.OrbitControls(this.camera, canvas);
    this.controls.zoomToCursor = true;
    this.controls.addEventListener("change", () => { this.isMoved = true; this.draw(); });
    this.reset();
    new ResizeObserver(() => this.resize()).observe(canvas.parentElement);
    this.resize();
  }

  light() {
    this.scene.add(new THREE.HemisphereLight("#ffffff", "#c8c8c8", 2.2));
    const sun = new THREE.DirectionalLight("#ffffff", 1.2);
    this.camera.add(sun);
    this.scene.add(this.camera);
  }

  // The first viewpoint, moved back if the view is narrower than its intended aspect ratio.
  reset() {
    const {eye, focus, aspect} = data.scene.view;
    const [from, to] = [eye, focus].map(local);
    const {clientWidth, clientHeight} = this.canvas.parentElement;
    const back = Math.max(1, aspect * clientHeight / Math.max(clientWidth, 1));
    this.camera.fov = FOV_DEG;
    this.look(from.sub(to).multiplyScalar(back).add(to), to);
    this.isMoved = false;
  }

  look(from, to) {
    this.camera.position.copy(from);
    this.controls.target.copy(to);
    this.controls.update();
    this.resize();
  }

  resize() {
    const {clientWidth, clientHeight} = this.canvas.parentElement;
    if (!clientWidth || !clientHeight) return;
    this.renderer.setSize(clientWidth, clientHeight, false);
    this.camera.aspect = clientWidth / clientHeight;
    this.draw();
  }

  draw() {
    if (this.pending) return;
    this.pending = true;
    requestAnimationFrame(() => { this.pending = false; this.render(); });
  }

  render() {
    const reach = this.camera.position.length() + data.scene.size;
    this.camera.near = reach / 20000;
    this.camera.far = 4 * reach;
    this.camera.updateProjectionMatrix();
    this.renderer.render(this.scene, this.camera);
  }

  add(name, ...parts) {
    const group = new THREE.Group();
    group.add(...parts);
    group.visible = data.scene.layers[name]?.shown ?? true;
    this.layers[name] = group;
    this.scene.add(group);
  }

  // Pixels and depth of points (x, y, z one after the other); depth is negative behind the eye.
  project(points) {
    this.camera.updateMatrixWorld();
    const matrix = this.camera.matrixWorldInverse.clone().premultiply(this.camera.projectionMatrix);
    const m = matrix.elements;
    const {clientWidth, clientHeight} = this.canvas;
    const made = new Float32Array(points.length);
    for (let i = 0; i < points.length; i += 3) {
      const [x, y, z] = [points[i], points[i + 1], points[i + 2]];
      const w = m[3] * x + m[7] * y + m[11] * z + m[15];
      made[i] = ((m[0] * x + m[4] * y + m[8] * z + m[12]) / w + 1) / 2 * clientWidth;
      made[i + 1] = (1 - (m[1] * x + m[5] * y + m[9] * z + m[13]) / w) / 2 * clientHeight;
      made[i + 2] = w;
    }
    return made;
  }

  // The ray through a pixel of the canvas.
  ray(x, y) {
    const {clientWidth, clientHeight} = this.canvas;
    const at = new THREE.Vector2(2 * x / clientWidth - 1, 1 - 2 * y / clientHeight);
    const caster = new THREE.Raycaster();
    caster.setFromCamera(at, this.camera);
    return caster;
  }

  // Turns the view around its target: sideways around the upward axis, or over it.
  turn(sideways, over) {
    const arm = this.camera.position.clone().sub(this.controls.target);
    arm.applyAxisAngle(this.camera.up, sideways);
    const right = this.camera.up.clone().cross(arm).normalize();
    const tipped = arm.clone().applyAxisAngle(right, -over);
    if (Math.abs(tipped.clone().normalize().dot(this.camera.up)) < 0.98) arm.copy(tipped);
    this.look(arm.add(this.controls.target), this.controls.target);
  }

  zoom(times) {
    const {target} = this.controls;
    this.look(this.camera.position.clone().sub(target).multiplyScalar(times).add(target), target);
  }

  // Moves the eye along its direction until a sphere fills half of the picture.
  frame(center, radius) {
    const way = this.camera.position.clone().sub(this.controls.target).normalize();
    const distance = 2 * radius / Math.tan(this.camera.fov / 360 * Math.PI);
    this.look(way.multiplyScalar(Math.max(distance, data.scene.size / 100)).add(center), center);
  }

  picture(width, height, type, background = BACKGROUND) {
    this.renderer.setClearColor(background);
    this.renderer.setPixelRatio(1);
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.render();
    const url = this.canvas.toDataURL(type, 0.9);
    this.renderer.setClearColor(BACKGROUND);
    this.renderer.setPixelRatio(window.devicePixelRatio);
    this.resize();
    this.render();
    return url;
  }
}

const local = (point) => new THREE.Vector3(...point.map((x, i) => x - data.scene.origin[i]));

function fatLines(segments, width, options) {
  const geometry = new THREE.LineSegmentsGeometry().setPositions(segments);
  return new THREE.LineSegments2(geometry, new THREE.LineMaterial({linewidth: width, ...options}));
}

function triangles(layer) {
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(positions(layer), 3));
  const count = layer.corners.length / 3;
  const corner = (_, i) => layer.corners[(i % 3) * count + Math.floor(i / 3)];
  geometry.setIndex(new THREE.BufferAttribute(Uint32Array.from(layer.corners, corner), 1));
  return geometry;
}

// Triangles with the colours of photographs, which hold the scene's light already.
function textured(layer) {
  const geometry = triangles(layer);
  const {x, y} = layer.texture_points;
  const uv = Float32Array.from({length: 2 * x.length}, (_, i) => (i % 2 ? y : x)[i >> 1]);
  geometry.setAttribute("uv", new THREE.BufferAttribute(uv, 2));
  const map = new THREE.Texture(new Image());
  map.colorSpace = THREE.SRGBColorSpace;
  map.flipY = false;
  map.image.onload = () => { map.needsUpdate = true; view.draw(); };
  map.image.src = layer.texture;
  const options = {map, side: THREE.DoubleSide, ...BEHIND};
  return new THREE.Mesh(geometry, new THREE.MeshBasicMaterial(options));
}

function surface(layer, Material, options) {
  const geometry = triangles(layer);
  geometry.setAttribute("color", new THREE.BufferAttribute(layer.rgb, 3, true));
  geometry.computeVertexNormals();
  const made = new Material({vertexColors: true, side: THREE.DoubleSide, ...options});
  return new THREE.Mesh(geometry, made);
}

// Edges are drawn in front of their surfaces.
const BEHIND = {polygonOffset: true, polygonOffsetFactor: 2, polygonOffsetUnits: 8};

const MAKERS = {
  mesh: (layer) => [
    layer.texture ? textured(layer)
      : surface(layer, THREE.MeshLambertMaterial, {flatShading: true, ...BEHIND}),
  ],
  faces: (layer) => [
    surface(layer, THREE.MeshBasicMaterial, {transparent: true, opacity: 0.5, depthWrite: false}),
    fatLines(segmentsOf(positions(layer.outlines))[0], 1.5, {color: "#ffffff"}),
  ],
  points: (layer) => {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(positions(layer), 3));
    geometry.setAttribute("color", new THREE.BufferAttribute(layer.rgb, 3, true));
    const material = {size: 2, sizeAttenuation: false, vertexColors: true};
    return [new THREE.Points(geometry, new THREE.PointsMaterial(material))];
  },
  cameras: (layer) => [fatLines(segmentsOf(positions(layer))[0], 1.5, {color: "#e0655f"})],
  edges: (layer) => {
    const points = positions(layer);
    let rows;
    [edges.segments, rows] = segmentsOf(points);
    const owners = edgesOfLine();
    edges.owners = Int32Array.from(rows, (row) => owners[row]);
    edges.shown = new Uint8Array(edges.length.length).fill(1);
    return [fatLines(edges.segments, 3, {vertexColors: true})];
  },
};

// The edge of every point of the edges' layer.
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

function shade(by, share) {
  if (by === "edge") return new THREE.Color().setHSL(share, 0.7, 0.6);
  const at = Math.min(Math.max(share, 0), 1) * (RAMP.length - 1);
  const low = Math.min(Math.floor(at), RAMP.length - 2);
  return new THREE.Color(RAMP[low]).lerp(new THREE.Color(RAMP[low + 1]), at - low);
}

function colourEdges() {
  const by = byId("colour").value;
  const values = edgeValues(by);
  const [low, high] = colourRange(by, values);
  byId("scale").hidden = by === "edge";
  byId("least").textContent = Number(low.toPrecision(3));
  byId("most").textContent = `${Number(high.toPrecision(3))} ${UNITS[by] ?? ""}`;
  const shades = values.map((value) => shade(by, (value - low) / (high - low)));
  const rgb = new Float32Array(edges.segments.length);
  edges.owners.forEach((edge, i) => {
    const {r, g, b} = shades[edge];
    rgb.set([r, g, b, r, g, b], 6 * i);
  });
  const [lines] = view.layers.edges.children;
  lines.geometry.setColors(rgb);
  view.draw();
}

// Shows only edges of the chosen kind and length.
function filterEdges() {
  const [kind, least] = [Number(byId("kind").value), byId("least-length").valueAsNumber || 0];
  edges.shown = Uint8Array.from(edges.length, (length) => length >= least ? 1 : 0);
  if (kind >= 0) {
    const has = new Set();
    edges.curve_kinds.forEach((of, i) => { if (of === kind) has.add(edges.curve_edges[i]); });
    edges.shown.forEach((shown, edge) => { edges.shown[edge] = shown && has.has(edge) ? 1 : 0; });
  }
  // A hidden segment has both ends in one place.
  const kept = Float32Array.from(edges.segments);
  edges.owners.forEach((edge, i) => {
    if (!edges.shown[edge]) kept.copyWithin(6 * i + 3, 6 * i, 6 * i + 3);
  });
  view.layers.edges.children[0].geometry.setPositions(kept);
  const count = edges.shown.reduce((sum, shown) => sum + shown, 0);
  byId("filtered").textContent = count < edges.shown.length ? `${count} shown` : "";
  view.draw();
}

// The shown edge nearest to a pixel and the nearest point on it; null beyond PICK_PX.
function edgeAt(x, y) {
  if (!view.layers.edges?.visible) return null;
  const pixels = view.project(edges.segments);
  const near = [];
  for (let i = 0; i < edges.owners.length; ++i) {
    const [ax, ay, az, bx, by, bz] = pixels.subarray(6 * i, 6 * i + 6);
    if (!(az > 0 && bz > 0) || !edges.shown[edges.owners[i]]) continue;
    const [dx, dy] = [bx - ax, by - ay];
    const along = ((x - ax) * dx + (y - ay) * dy) / Math.max(dx * dx + dy * dy, 1e-12);
    const t = Math.min(Math.max(along, 0), 1);
    const distance = Math.hypot(ax + t * dx - x, ay + t * dy - y);
    // Along the pixels t is even, in space the nearer end counts less.
    const share = t * az / (t * az + (1 - t) * bz);
    if (distance <= PICK_PX) near.push({distance, depth: az + share * (bz - az), i, share});
  }
  const least = Math.min(...near.map((each) => each.distance));
  const [best] = near.filter((each) => each.distance <= least + FRONT_PX)
    .sort((a, b) => a.depth - b.depth);
  if (!best) return null;
  const [first, last] = [0, 3].map((k) =>
    new THREE.Vector3(...edges.segments.subarray(6 * best.i + k, 6 * best.i + k + 3)));
  return {edge: edges.owners[best.i], point: first.lerp(last, best.share)};
}

// The point under a pixel: on an edge, else on the mesh or the faces, else the nearest SfM point.
function pointAt(x, y) {
  const found = edges && edgeAt(x, y);
  if (found) return found.point;
  const solid = ["mesh", "faces"].map((name) => view.layers[name]).filter((each) => each?.visible);
  const [hit] = view.ray(x, y).intersectObjects(solid.map((each) => each.children[0]));
  if (hit) return hit.point;
  if (!view.layers.points.visible) return null;
  const points = view.layers.points.children[0].geometry.attributes.position.array;
  const pixels = view.project(points);
  let [best, least] = [-1, PICK_PX];
  for (let i = 0; i < pixels.length; i += 3) {
    const distance = Math.hypot(pixels[i] - x, pixels[i + 1] - y);
    if (pixels[i + 2] > 0 && distance < least) [best, least] = [i, distance];
  }
  return best < 0 ? null : new THREE.Vector3(...points.subarray(best, best + 3));
}

let measured = [];

function measure(point) {
  if (measured.length === 2) measured = [];
  measured.push(point);
  if (view.layers.measured) view.scene.remove(view.layers.measured);
  const [first, last] = [measured[0], measured[measured.length - 1]];
  const segment = Float32Array.from([...first.toArray(), ...last.toArray()]);
  const line = fatLines(segment, 3, {color: "#ffe14d", depthTest: false});
  const ends = new THREE.BufferGeometry();
  ends.setAttribute("position", new THREE.BufferAttribute(segment, 3));
  const dots = {color: "#ffe14d", size: 9, sizeAttenuation: false, depthTest: false};
  view.add("measured", line, new THREE.Points(ends, new THREE.PointsMaterial(dots)));
  byId("distance").textContent = measured.length < 2 ? "Click the second point."
    : `${number(first.distanceTo(last))} scene units`;
  view.draw();
}

function stopMeasuring() {
  if (view.layers.measured) view.scene.remove(view.layers.measured);
  measured = [];
  byId("distance").textContent = byId("measure").checked ? "Click the first point." : "";
  view.draw();
}

const number = (value) => Number(value.toPrecision(5)).toString();

function row(table, name, ...content) {
  const made = table.insertRow();
  const head = document.createElement("th");
  [head.scope, head.textContent] = ["row", name];
  made.append(head);
  made.insertCell().append(...content.map(String));
  return made;
}

function withDeviation(value, sigma) {
  return Number.isFinite(sigma) ? `${number(value)} ± ${Number(sigma.toPrecision(2))}` : number(value);
}

function curveRows(table, edge) {
  edges.curve_edges.forEach((owner, i) => {
    if (owner !== edge) return;
    const [kind, radius] = [edges.kind_names[edges.curve_kinds[i]], edges.curve_radii[i]];
    const text = `length ${number(edges.curve_lengths[i])}`;
    const round = Number.isFinite(radius)
      ? `, radius ${withDeviation(radius, edges.radius_sigmas[i])}` : "";
    row(table, kind.replace("_", " "), text + round);
  });
}

function neighboursOf(edge) {
  const found = new Set();
  for (const node of edges.nodes.subarray(2 * edge, 2 * edge + 2)) {
    if (node < 0) continue;
    edges.nodes.forEach((other, i) => { if (other === node) found.add(i >> 1); });
    if (edges.through[node] >= 0) found.add(edges.through[node]);
  }
  edges.through.forEach((passing, node) => {
    if (passing === edge) edges.nodes.forEach((other, i) => { if (other === node) found.add(i >> 1); });
  });
  found.delete(edge);
  return [...found].sort((a, b) => a - b);
}

function factsOf(edge) {
  const table = document.createElement("table");
  row(table, "number", edge);
  row(table, "length, scene units", number(edges.length[edge]));
  curveRows(table, edge);
  row(table, "views", edges.views[edge]);
  row(table, "points", edges.points[edge]);
  row(table, "mean residual, px", edges.residual[edge].toFixed(3));
  if (Number.isFinite(edges.sigmas[edge])) {
    row(table, "deviation of a point", Number(edges.sigmas[edge].toPrecision(2)));
  }
  const digits = Math.max(5 - Math.floor(Math.log10(data.scene.size)), 0);
  ["start", "end"].forEach((name, side) => {
    const at = Array.from(edges.ends.subarray(6 * edge + 3 * side, 6 * edge + 3 * side + 3));
    row(table, name, at.map((x, i) => (x + data.scene.origin[i]).toFixed(digits)).join(", "));
  });
  const cell = row(table, "neighbours").cells[1];
  const others = neighboursOf(edge);
  cell.textContent = others.length ? "" : "none";
  for (const other of others) {
    const button = document.createElement("button");
    [button.type, button.textContent] = ["button", other];
    button.addEventListener("click", () => chooseEdge(other, true));
    cell.append(button, " ");
  }
  return table;
}

function chooseEdge(edge, framed) {
  const mine = [];
  edges.owners.forEach((owner, i) => {
    if (owner === edge) mine.push(...edges.segments.subarray(6 * i, 6 * i + 6));
  });
  if (view.layers.chosen) view.scene.remove(view.layers.chosen);
  const line = fatLines(Float32Array.from(mine), 7, {color: CHOSEN, depthTest: false});
  view.add("chosen", line);
  byId("chosen").replaceChildren(factsOf(edge));
  byId("number").value = edge;
  byId("frame").hidden = false;
  if (framed) frameEdge();
  showReprojections(edge);
  view.draw();
}

function frameEdge() {
  const {center, radius} = view.layers.chosen.children[0].geometry.boundingSphere ?? sphereOfChosen();
  view.frame(center.clone(), radius);
}

function sphereOfChosen() {
  const {geometry} = view.layers.chosen.children[0];
  geometry.computeBoundingSphere();
  return geometry.boundingSphere;
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
  pen.fillStyle = CHOSEN;
  const size = Math.max(canvas.width / 160, 3);
  for (const [x, y] of points) {
    pen.fillRect(x * canvas.width - size / 2, y * canvas.height - size / 2, size, size);
  }
  figure.querySelector(".stack").append(canvas);
  return figure;
}

// A click is a press and a release at one position.
function listenForClicks() {
  let pressed = null;
  view.canvas.addEventListener("pointerdown", (event) => { pressed = event; });
  view.canvas.addEventListener("pointerup", (event) => {
    const moved = pressed ? Math.hypot(event.x - pressed.x, event.y - pressed.y) : Infinity;
    pressed = null;
    if (moved >= MAX_CLICK_PX) return;
    const box = view.canvas.getBoundingClientRect();
    const at = [event.x - box.left, event.y - box.top];
    if (byId("measure").checked) {
      const point = pointAt(...at);
      if (point) measure(point);
      return;
    }
    const found = edges && edgeAt(...at);
    if (found) chooseEdge(found.edge, false);
  });
}

function turnByKeys(event) {
  if (KEYS[event.key]) {
    view.turn(...KEYS[event.key].map((times) => times * TURN));
  } else if (NEARER[event.key]) {
    view.zoom(NEARER[event.key]);
  } else {
    return;
  }
  event.preventDefault();
}

// Looks from a camera's position in its direction, with its image's height in view.
function goToCamera(index) {
  const {poses, slopes} = data.scene.layers.cameras;
  const lines = positions(data.scene.layers.cameras);
  const perCamera = lines.length / slopes.length;
  const center = new THREE.Vector3(...lines.subarray(perCamera * index, perCamera * index + 3));
  const forward = new THREE.Vector3(...poses.subarray(9 * index + 6, 9 * index + 9));
  const depth = Math.max(center.clone().negate().dot(forward), data.scene.size / 20);
  view.camera.fov = 360 / Math.PI * Math.atan(slopes[index]);
  view.look(center, center.clone().addScaledVector(forward, depth));
}

function bindCameras() {
  const choice = byId("camera");
  data.scene.layers.cameras.names.forEach((name, index) => choice.add(new Option(name, index)));
  choice.addEventListener("change", () => {
    if (choice.value !== "") goToCamera(Number(choice.value));
  });
}

// Print shows the current view, on white.
function keepPictureForPrint() {
  const first = byId("still").src;
  window.addEventListener("beforeprint", () => {
    byId("still").src = view.isMoved ? view.picture(1280, 800, "image/jpeg", "#ffffff") : first;
  });
}

function savePicture() {
  const link = document.createElement("a");
  link.href = view.picture(...PICTURE, "image/png");
  link.download = `${document.title}.png`;
  link.click();
}

function addLayer(name) {
  const layer = data.scene.layers[name];
  if (!layer) return;
  view.add(name, ...MAKERS[name](layer));
  const [label, box] = ["label", "input"].map((n) => document.createElement(n));
  [box.type, box.checked, box.id] = ["checkbox", layer.shown, `layer-${name}`];
  box.addEventListener("change", () => {
    view.layers[name].visible = box.checked;
    const other = box.checked && byId(`layer-${INSTEAD_OF[name]}`);
    if (other && other.checked) other.click();
    view.draw();
  });
  label.append(box, ` ${layer.label}`);
  byId("layers").append(label);
}

function bindLayer(name) {
  const box = byId(`show-${name}`);
  box.addEventListener("change", () =>
    byId("pictures").classList.toggle(`hide-${name}`, !box.checked));
  box.parentElement.hidden = !document.querySelector(`#pictures .${name}`);
}

let data, edges, view;

function bindEdges() {
  byId("colour").addEventListener("change", colourEdges);
  const kinds = new Set(edges.curve_kinds);
  edges.kind_names.forEach((name, kind) => {
    if (kinds.has(kind)) byId("kind").add(new Option(name.replace("_", " "), kind));
  });
  byId("kind").addEventListener("change", filterEdges);
  byId("least-length").addEventListener("input", filterEdges);
  byId("number").max = edges.length.length - 1;
  byId("number").addEventListener("change", (event) => {
    const asked = event.target.valueAsNumber;
    if (Number.isInteger(asked) && asked >= 0 && asked < edges.length.length) chooseEdge(asked, true);
  });
  byId("frame").addEventListener("click", frameEdge);
}

// The address may end with an edge, as in report.html#edge=12.
function chooseByAddress() {
  const asked = Number(/^#edge=(\d+)$/.exec(location.hash)?.[1] ?? NaN);
  if (asked < edges.length.length) chooseEdge(asked, true);
}

async function show3D() {
  data = await readData();
  edges = data.edges;
  document.querySelectorAll(".of-edges").forEach((element) => { element.hidden = !edges; });
  byId("viewer").classList.toggle("alone", !edges);
  byId("controls").hidden = false;
  await loadThree();
  view = new View3D(byId("view"));
  ["edges", "mesh", "faces", "points", "cameras"].forEach(addLayer);
  document.body.classList.add("drawn");
  view.canvas.addEventListener("keydown", turnByKeys);
  byId("save").addEventListener("click", savePicture);
  byId("reset").addEventListener("click", () => { byId("camera").value = ""; view.reset(); });
  byId("measure").addEventListener("change", stopMeasuring);
  bindCameras();
  listenForClicks();
  keepPictureForPrint();
  if (edges) {
    bindEdges();
    colourEdges();
    chooseByAddress();
    window.addEventListener("hashchange", chooseByAddress);
  }
  view.render();
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
