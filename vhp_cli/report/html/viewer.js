"use strict";
// The model in three dimensions. `window.vhp` tells what is shown, and lets a script do what a person can.
(() => {
const started = performance.now();
const byId = id => document.getElementById(id);
const { tissues, findings } = JSON.parse(byId("scene").textContent);
const canvas = byId("canvas"), stage = byId("stage"), rings = byId("rings"), chip = byId("chip");
const LEVELS = { error: [0.83, 0.18, 0.13], warning: [0.85, 0.56, 0.12], note: [0.25, 0.50, 0.75] };
const VERDICTS = { error: [0.78, 0.28, 0.24], warning: [0.87, 0.65, 0.30], pass: [0.60, 0.70, 0.64] };
const FRONT = [0, 0.12], FADED = 0.05, BESIDE = 0.45;

const camera = { target: [0, 0, 0], reach: 1, turn: 0.5, lean: 0.15 };  // mm; reach: from the middle to the upper edge
const state = { selected: null, finding: null, place: 0, focus: null, colour: "type", edges: false, dots: true, cut: null };
let gl = null, draws = null, whole = { middle: [0, 0, 0], radius: 1 }, dirty = false, flight = null, ground = [1, 1, 1];

// ---- unpacking: the inverse of packing.py

function bytesOf(text) {
  if (Uint8Array.fromBase64) return Uint8Array.fromBase64(text);
  const raw = atob(text), out = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) out[i] = raw.charCodeAt(i);
  return out;
}

async function unpack(text) {
  const stream = new Blob([bytesOf(text)]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// Corners of all faces one after another, 4 numbers each: three of the place, and the quality of the face.
function expand(raw) {
  let V = 0, F = 0;
  for (const tissue of tissues) { V += tissue.vertices; F += tissue.faces; }
  const out = new Uint16Array(12 * F), place = new Uint16Array(3 * V);
  const C = 6 * V, Q = C + 9 * F;
  let v0 = 0, f0 = 0;
  for (const tissue of tissues) {
    for (let axis = 0; axis < 3; axis++) {
      let last = 0;
      for (let i = v0; i < v0 + tissue.vertices; i++) {
        const code = raw[axis * V + i] | raw[(axis + 3) * V + i] << 8;
        last = last + (code >> 1 ^ -(code & 1)) & 65535;
        place[3 * i + axis] = last;
      }
    }
    let next = 0;
    for (let i = 3 * f0; i < 3 * (f0 + tissue.faces); i++) {
      const code = raw[C + i] | raw[C + 3 * F + i] << 8 | raw[C + 6 * F + i] << 16;
      const vertex = next - code;
      if (code === 0) next++;
      const from = 3 * (v0 + vertex);
      out[4 * i] = place[from];
      out[4 * i + 1] = place[from + 1];
      out[4 * i + 2] = place[from + 2];
      out[4 * i + 3] = raw[Q + (i / 3 | 0)];
    }
    tissue.first = 3 * f0;
    box(tissue, place, v0);
    v0 += tissue.vertices;
    f0 += tissue.faces;
  }
  return out;
}

function box(tissue, place, v0) {
  const low = [65535, 65535, 65535], high = [0, 0, 0];
  for (let i = v0; i < v0 + tissue.vertices; i++) {
    for (let axis = 0; axis < 3; axis++) {
      const value = place[3 * i + axis];
      if (value < low[axis]) low[axis] = value;
      if (value > high[axis]) high[axis] = value;
    }
  }
  tissue.min = low.map((value, axis) => tissue.low[axis] + value * tissue.step);
  tissue.max = high.map((value, axis) => tissue.low[axis] + value * tissue.step);
}

// ---- geometry of the view; x to the left of the person, y to the back, z up

const sub = (a, b) => a.map((value, i) => value - b[i]);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];

function axes() {
  const { turn, lean } = camera;
  const right = [Math.cos(turn), Math.sin(turn), 0];
  const towards = [Math.sin(turn) * Math.cos(lean), -Math.cos(turn) * Math.cos(lean), Math.sin(lean)];
  return [right, cross(towards, right), towards];
}

function aspect() { return Math.max(canvas.clientWidth, 1) / Math.max(canvas.clientHeight, 1); }

function onScreen(point) {
  const [right, up] = axes(), from = sub(point, camera.target), half = canvas.clientHeight / 2;
  return [canvas.clientWidth / 2 + dot(from, right) / camera.reach * half, half - dot(from, up) / camera.reach * half];
}

function boxOf(some) {
  const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
  for (const tissue of some) {
    if (!tissue.faces) continue;
    for (let axis = 0; axis < 3; axis++) {
      low[axis] = Math.min(low[axis], tissue.min[axis]);
      high[axis] = Math.max(high[axis], tissue.max[axis]);
    }
  }
  if (!(low[0] <= high[0])) return null;
  return { middle: low.map((value, i) => (value + high[i]) / 2), low, high, radius: Math.hypot(...sub(high, low)) / 2 || 1 };
}

// Turns to a view; the way there takes a moment, unless motion is not wanted.
function flyTo(wanted) {
  const from = { ...camera, target: [...camera.target] };
  const to = { ...from, ...wanted };
  if (matchMedia("(prefers-reduced-motion: reduce)").matches) {
    Object.assign(camera, to);
    flight = null;
  } else {
    to.turn = from.turn + ((to.turn - from.turn + Math.PI) % (2 * Math.PI) + 2 * Math.PI) % (2 * Math.PI) - Math.PI;
    flight = { from, to, start: performance.now() };
  }
  redraw();
}

function advance(now) {
  if (!flight) return;
  const share = Math.min((now - flight.start) / 450, 1), s = share * share * (3 - 2 * share);
  const { from, to } = flight;
  camera.target = from.target.map((value, i) => value + s * (to.target[i] - value));
  camera.reach = from.reach * (to.reach / from.reach) ** s;
  camera.turn = from.turn + s * (to.turn - from.turn);
  camera.lean = from.lean + s * (to.lean - from.lean);
  if (share === 1) { Object.assign(camera, to); flight = null; }
}

function fit(some = tissues.filter(tissue => tissue.shown), view = null) {
  const box = boxOf(some) ?? boxOf(tissues);
  if (!box) return;
  const [turn, lean] = view ?? [camera.turn, camera.lean];
  const keep = [camera.turn, camera.lean];
  [camera.turn, camera.lean] = [turn, lean];
  const [right, up] = axes();
  [camera.turn, camera.lean] = keep;
  const size = sub(box.high, box.low);
  const span = axis => axis.reduce((sum, value, i) => sum + Math.abs(value) * size[i], 0) / 2;
  flyTo({ target: box.middle, reach: 1.06 * Math.max(span(up), span(right) / aspect(), 1e-6), turn, lean });
}

// ---- drawing

const VERTEX = `#version 300 es
layout(location = 0) in vec4 place;
uniform vec3 low; uniform float unit; uniform mat3 axes; uniform vec3 zoom;
out vec3 at; out vec3 corner; flat out float quality;
void main() {
  at = low + unit * place.xyz;
  int k = gl_VertexID % 3;
  corner = vec3(k == 0, k == 1, k == 2);
  quality = place.w / 255.0;
  vec3 seen = axes * at;
  gl_Position = vec4(seen * zoom, 1.0);
}`;
const FRAGMENT = `#version 300 es
precision highp float;
in vec3 at; in vec3 corner; flat in float quality;
uniform mat3 axes; uniform vec4 colour; uniform float byQuality, edges, lift; uniform vec4 cut;
out vec4 paint;
vec3 ramp(float q) {
  vec3 a = vec3(0.70, 0.15, 0.12), b = vec3(0.88, 0.54, 0.24), c = vec3(0.93, 0.86, 0.63), d = vec3(0.44, 0.62, 0.75);
  return q < 0.3 ? mix(a, b, q / 0.3) : q < 0.6 ? mix(b, c, (q - 0.3) / 0.3) : mix(c, d, (q - 0.6) / 0.4);
}
void main() {
  if (dot(cut.xyz, at) > cut.w) discard;
  vec3 n = normalize(axes * cross(dFdx(at), dFdy(at)));
  if (n.z < 0.0) n = -n;
  vec3 base = byQuality > 0.5 ? ramp(quality * quality) : colour.rgb;
  float light = 0.34 + 0.46 * max(dot(n, normalize(vec3(-0.45, 0.65, 0.62))), 0.0) + 0.26 * n.z;
  if (!gl_FrontFacing) light *= 0.62;
  vec3 lit = base * min(light, 1.05) + lift;
  if (edges > 0.0) {
    vec3 width = fwidth(corner);
    vec3 near = smoothstep(vec3(0.0), width * 1.3, corner);
    lit *= 1.0 - edges * (1.0 - min(near.x, min(near.y, near.z)));
  }
  paint = vec4(lit, colour.a);
}`;
// For clicks: number of the tissue, or depth, as colours.
const PICK = `#version 300 es
precision highp float;
in vec3 at; in vec3 corner; flat in float quality;
uniform vec4 cut; uniform int number;
out vec4 paint;
void main() {
  if (dot(cut.xyz, at) > cut.w) discard;
  if (number >= 0) { paint = vec4(float(number & 255), float(number >> 8 & 255), float(number >> 16), 255.0) / 255.0; return; }
  uint depth = uint(gl_FragCoord.z * 16777215.0);
  paint = vec4(float(depth & 255u), float(depth >> 8 & 255u), float(depth >> 16), 255.0) / 255.0;
}`;
const DOT_VERTEX = `#version 300 es
layout(location = 0) in vec3 place; layout(location = 1) in vec3 tone;
uniform vec3 low; uniform mat3 axes; uniform vec3 zoom; uniform float size;
out vec3 painted;
void main() { painted = tone; gl_Position = vec4(axes * (low + place) * zoom, 1.0); gl_PointSize = size; }`;
const DOT_FRAGMENT = `#version 300 es
precision highp float;
in vec3 painted; out vec4 paint;
void main() {
  float r = length(gl_PointCoord - 0.5);
  if (r > 0.5) discard;
  paint = vec4(r > 0.34 ? vec3(1.0) : painted, 0.9);
}`;

function program(vertex, fragment) {
  const made = gl.createProgram(), names = {};
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(made));
  for (let i = 0; i < gl.getProgramParameter(made, gl.ACTIVE_UNIFORMS); i++) {
    const { name } = gl.getActiveUniform(made, i);
    names[name] = gl.getUniformLocation(made, name);
  }
  return { made, names };
}

function arrayOf(data, attributes, usage) {
  const array = gl.createVertexArray(), buffer = gl.createBuffer();
  gl.bindVertexArray(array);
  gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
  gl.bufferData(gl.ARRAY_BUFFER, data, usage ?? gl.STATIC_DRAW);
  let offset = 0;
  const kind = data instanceof Uint16Array ? gl.UNSIGNED_SHORT : gl.FLOAT;
  const stride = attributes.reduce((sum, size) => sum + size, 0) * data.BYTES_PER_ELEMENT;
  attributes.forEach((size, index) => {
    gl.enableVertexAttribArray(index);
    gl.vertexAttribPointer(index, size, kind, false, stride, offset);
    offset += size * data.BYTES_PER_ELEMENT;
  });
  return { array, buffer };
}

function setUp(corners) {
  gl.enable(gl.DEPTH_TEST);
  gl.depthFunc(gl.LEQUAL);
  gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
  const spots = findings.flatMap(finding => (finding.known ? [] : finding.places.slice(0, 1))
    .map(place => [...sub(place.at, whole.middle), ...LEVELS[finding.level]])).flat();
  draws = {
    surface: program(VERTEX, FRAGMENT), pick: program(VERTEX, PICK), dots: program(DOT_VERTEX, DOT_FRAGMENT),
    model: arrayOf(corners, [4]), hot: arrayOf(new Float32Array(4), [4], gl.DYNAMIC_DRAW),
    spots: arrayOf(new Float32Array(spots), [3, 3]), spotCount: spots.length / 6, target: null,
  };
}

function opacityOf(tissue) {
  if (state.focus && !state.focus.has(tissue.index)) return tissue.opacity * FADED;
  if (state.finding === null) return tissue.opacity;
  // The tissue with the place is seen as it is, the other one of a pair lets it show through.
  return tissue.index === state.selected ? 1 : Math.min(tissue.opacity, BESIDE);
}

// The colour behind the model is that of the page.
function readGround() {
  const found = getComputedStyle(stage).backgroundColor.match(/[\d.]+/g);
  if (found) ground = found.slice(0, 3).map(part => Number(part) / 255);
  redraw();
}

function colourOf(tissue) {
  return state.colour === "verdict" ? VERDICTS[tissue.verdict] : tissue.colour;
}

function scaleOf() {
  const [right, up, towards] = axes();
  const deep = 2 * whole.radius + Math.hypot(...sub(camera.target, whole.middle)) + camera.reach;
  return {
    zoom: [1 / camera.reach / aspect(), 1 / camera.reach, -1 / deep], deep,
    // Column by column, as WebGL takes it.
    turn: [0, 1, 2].flatMap(i => [right[i], up[i], towards[i]]),
  };
}

function cutting() {
  if (state.cut === null) return [0, 0, 0, 1];
  const { axis, at } = state.cut, plane = [0, 0, 0];
  plane[axis] = 1;
  return [...plane, at - camera.target[axis]];
}

function drawTissue(names, tissue) {
  gl.uniform3fv(names.low, sub(tissue.low, camera.target));
  gl.uniform1f(names.unit, tissue.step);
  gl.drawArrays(gl.TRIANGLES, tissue.first, 3 * tissue.faces);
}

function draw() {
  const ratio = Math.min(devicePixelRatio || 1, 2);
  const [width, height] = [canvas.clientWidth, canvas.clientHeight].map(size => Math.max(Math.round(size * ratio), 1));
  if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
  gl.viewport(0, 0, width, height);
  gl.clearColor(...ground, 1);
  gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
  const { zoom, turn } = scaleOf(), { made, names } = draws.surface;
  gl.useProgram(made);
  gl.uniformMatrix3fv(names.axes, false, turn);
  gl.uniform3fv(names.zoom, zoom);
  gl.uniform4fv(names.cut, cutting());
  gl.uniform1f(names.byQuality, state.colour === "q" ? 1 : 0);
  gl.uniform1f(names.edges, state.edges ? 0.6 : 0);
  gl.bindVertexArray(draws.model.array);
  const seen = tissues.filter(tissue => tissue.shown && tissue.faces && opacityOf(tissue) > 0);
  const paint = tissue => {
    gl.uniform4fv(names.colour, [...colourOf(tissue), opacityOf(tissue)]);
    gl.uniform1f(names.lift, tissue.index === state.selected ? 0.07 : 0);
    drawTissue(names, tissue);
  };
  gl.disable(gl.BLEND);
  seen.filter(tissue => opacityOf(tissue) === 1).forEach(paint);
  drawHot(names, false);
  // What can be seen through: large ones first, as they hold the others; of each the far side, then the near one.
  gl.useProgram(made);
  gl.bindVertexArray(draws.model.array);
  gl.enable(gl.BLEND);
  gl.depthMask(false);
  gl.enable(gl.CULL_FACE);
  for (const tissue of seen.filter(tissue => opacityOf(tissue) < 1).sort((a, b) => b.size - a.size || a.index - b.index)) {
    for (const side of [gl.FRONT, gl.BACK]) { gl.cullFace(side); paint(tissue); }
  }
  gl.disable(gl.CULL_FACE);
  drawHot(names, true);
  gl.depthMask(true);
  drawDots(turn, zoom, ratio);
  placeRings();
}

// The face of the finding, exactly: a little in front of the surface; and faintly through whatever hides it.
function drawHot(names, through) {
  const place = state.finding === null ? null : findings[state.finding].places[state.place];
  if (!place?.corners) return;
  const data = new Float32Array(12);
  for (let i = 0; i < 3; i++) data.set([...place.corners.slice(3 * i, 3 * i + 3), 255], 4 * i);
  gl.bindVertexArray(draws.hot.array);
  gl.bindBuffer(gl.ARRAY_BUFFER, draws.hot.buffer);
  gl.bufferData(gl.ARRAY_BUFFER, data, gl.DYNAMIC_DRAW);
  if (through) gl.disable(gl.DEPTH_TEST);
  gl.enable(gl.POLYGON_OFFSET_FILL);
  gl.polygonOffset(-4, -40);
  gl.uniform3fv(names.low, sub(place.at, camera.target));
  gl.uniform1f(names.unit, 1);
  gl.uniform1f(names.byQuality, 0);
  gl.uniform1f(names.lift, 0.12);
  gl.uniform4fv(names.colour, [...LEVELS.error, through ? 0.35 : 1]);
  gl.drawArrays(gl.TRIANGLES, 0, 3);
  gl.disable(gl.POLYGON_OFFSET_FILL);
  gl.enable(gl.DEPTH_TEST);
  gl.uniform1f(names.byQuality, state.colour === "q" ? 1 : 0);
}

function drawDots(turn, zoom, ratio) {
  if (!state.dots || !draws.spotCount || state.finding !== null) return;
  const { made, names } = draws.dots;
  gl.useProgram(made);
  gl.uniformMatrix3fv(names.axes, false, turn);
  gl.uniform3fv(names.zoom, zoom);
  gl.uniform3fv(names.low, sub(whole.middle, camera.target));
  gl.uniform1f(names.size, 7 * ratio);
  gl.bindVertexArray(draws.spots.array);
  gl.disable(gl.DEPTH_TEST);
  gl.drawArrays(gl.POINTS, 0, draws.spotCount);
  gl.enable(gl.DEPTH_TEST);
}

function placeRings() {
  const places = state.finding === null ? [] : findings[state.finding].places;
  const shapes = places.flatMap((place, index) => {
    const [x, y] = onScreen(place.at), here = index === state.place;
    return ["halo", "ring"].map(kind => `<circle class="${kind}" cx="${x.toFixed(1)}" cy="${y.toFixed(1)}" ` +
      `r="${here ? 16 : 6}"${here ? "" : ' opacity=".6"'}/>`);
  });
  rings.innerHTML = shapes.join("");
}

function redraw() {
  if (dirty || !draws) return;
  dirty = true;
  requestAnimationFrame(now => {
    dirty = false;
    advance(now);
    draw();
    if (flight) redraw();
  });
}

// ---- clicks on the model

function pick(x, y) {
  const [width, height] = [canvas.width, canvas.height], ratio = width / Math.max(canvas.clientWidth, 1);
  const [column, row] = [Math.floor(x * ratio), height - 1 - Math.floor(y * ratio)];
  if (draws.target?.width !== width || draws.target?.height !== height) {
    draws.target = { width, height, frame: gl.createFramebuffer() };
    gl.bindFramebuffer(gl.FRAMEBUFFER, draws.target.frame);
    for (const [point, form] of [[gl.COLOR_ATTACHMENT0, gl.RGBA8], [gl.DEPTH_ATTACHMENT, gl.DEPTH_COMPONENT24]]) {
      const buffer = gl.createRenderbuffer();
      gl.bindRenderbuffer(gl.RENDERBUFFER, buffer);
      gl.renderbufferStorage(gl.RENDERBUFFER, form, width, height);
      gl.framebufferRenderbuffer(gl.FRAMEBUFFER, point, gl.RENDERBUFFER, buffer);
    }
  }
  gl.bindFramebuffer(gl.FRAMEBUFFER, draws.target.frame);
  gl.viewport(0, 0, width, height);
  gl.enable(gl.SCISSOR_TEST);
  gl.scissor(column, row, 1, 1);
  const { zoom, turn, deep } = scaleOf(), { made, names } = draws.pick, found = new Uint8Array(4);
  gl.useProgram(made);
  gl.uniformMatrix3fv(names.axes, false, turn);
  gl.uniform3fv(names.zoom, zoom);
  gl.uniform4fv(names.cut, cutting());
  gl.bindVertexArray(draws.model.array);
  gl.disable(gl.BLEND);
  // What is hardly there lets a click through, unless nothing else is hit.
  const values = [0.3, 0].map(least => [false, true].map(depth => {
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    for (const tissue of tissues) {
      if (!tissue.shown || !tissue.faces || opacityOf(tissue) <= least) continue;
      gl.uniform1i(names.number, depth ? -1 : tissue.index);
      drawTissue(names, tissue);
    }
    gl.readPixels(column, row, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, found);
    return found[3] ? found[0] | found[1] << 8 | found[2] << 16 : null;
  })).find(([tissue]) => tissue !== null);
  gl.disable(gl.SCISSOR_TEST);
  gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  if (!values) return null;
  const [right, up, towards] = axes(), half = canvas.clientHeight / 2;
  const [across, above] = [(x - canvas.clientWidth / 2) / half * camera.reach, (half - y) / half * camera.reach];
  const near = -(2 * values[1] / 16777215 - 1) * deep;
  return {
    tissue: values[0],
    at: camera.target.map((value, i) => value + across * right[i] + above * up[i] + near * towards[i]),
  };
}

// ---- what a person does

const inMm = at => `${at.map(value => value.toFixed(3)).join(", ")} mm`;

function say(title, text, at) {
  chip.hidden = false;
  byId("chip-name").textContent = title;
  byId("chip-words").textContent = text;
  byId("chip-place").textContent = at ? inMm(at) : "";
}

function mark() {
  for (const row of document.querySelectorAll("table.tissues tr.on, .go.on, .spot.on, .list li.on")) row.classList.remove("on");
  if (state.finding !== null) {
    for (const button of document.querySelectorAll(`.go[data-finding="${state.finding}"], .spot[data-finding="${state.finding}"]`)) {
      button.classList.toggle("on", Number(button.dataset.place) === state.place);
    }
  }
  if (state.selected !== null) {
    document.querySelector(`table.tissues [data-tissue="${state.selected}"]`)?.closest("tr").classList.add("on");
  }
  byId("opacity").value = 100 * (state.selected === null ? 1 : tissues[state.selected].opacity);
}

function select(index, { at = null, fly = true } = {}) {
  const tissue = tissues[index];
  if (!tissue) return;
  Object.assign(state, { selected: index, finding: null, focus: null });
  const facts = [tissue.type, `${tissue.triangles.toLocaleString("en")} triangles`];
  if (tissue.q !== null) facts.push(`least q ${tissue.q.toPrecision(3)}`);
  facts.push(tissue.words);
  if (!tissue.faces) facts.push("not shown");
  say(tissue.name, facts.join(" · "), at);
  if (fly && tissue.faces) {
    setShown(tissue, true);
    state.focus = new Set([index]);
    fit([tissue]);
  }
  mark();
  redraw();
}

function show(index, number = 0) {
  const finding = findings[index], place = finding?.places[number];
  if (!place) return;
  const concerned = finding.tissues.filter(tissue => tissues[tissue].faces);
  concerned.forEach(tissue => setShown(tissues[tissue], true));
  Object.assign(state, {
    finding: index, place: number, selected: place.tissue ?? concerned[0] ?? null, focus: new Set(concerned),
  });
  const names = finding.tissues.map(tissue => tissues[tissue].name).join(" and ");
  const face = place.face === null ? "" : ` · face ${place.face}`;
  say(`${finding.rule} ${names || "model"}`, finding.message + face, place.at);
  const view = { target: place.at, reach: place.reach ?? Math.max(0.08 * whole.radius, 1e-3) };
  if (place.normal) {
    const [x, y, z] = place.normal;
    Object.assign(view, { turn: Math.atan2(x, -y), lean: Math.max(-1.3, Math.min(1.3, Math.asin(z))) });
  }
  flyTo(view);
  mark();
}

function letGo() {
  Object.assign(state, { selected: null, finding: null, focus: null });
  chip.hidden = true;
  mark();
  redraw();
}

function setShown(tissue, shown) {
  tissue.shown = shown;
  if (tissue.box) tissue.box.checked = shown;
  redraw();
}

function showOnly(indices) {
  for (const tissue of tissues) setShown(tissue, indices.has(tissue.index));
  state.focus = null;
}

function showPair(text) {
  const indices = text.split(",").filter(part => part !== "").map(Number);
  const found = findings.findIndex(finding => finding.places.length && finding.tissues.length === 2
    && indices.every(index => finding.tissues.includes(index)));
  if (found >= 0) { show(found); return; }
  indices.forEach(index => setShown(tissues[index], true));
  Object.assign(state, { finding: null, selected: indices[0], focus: new Set(indices) });
  say(indices.map(index => tissues[index].name).join(" and "), "", null);
  fit(indices.map(index => tissues[index]));
  mark();
}

function openCard(index) {
  const card = byId(`tissue-${index}`);
  document.documentElement.classList.remove("is-wide");
  byId("wide").setAttribute("aria-pressed", "false");
  card.hidden = false;
  card.querySelector("details").open = true;
  card.scrollIntoView({ block: "center" });
}

// ---- mouse, fingers, keys

function turnBy(x, y) {
  flight = null;
  camera.turn -= 0.008 * x;
  camera.lean = Math.max(-Math.PI / 2, Math.min(Math.PI / 2, camera.lean + 0.008 * y));
  redraw();
}

function moveBy(x, y) {
  flight = null;
  const [right, up] = axes(), mm = 2 * camera.reach / Math.max(canvas.clientHeight, 1);
  camera.target = camera.target.map((value, i) => value - mm * (x * right[i] - y * up[i]));
  redraw();
}

// The point under the pointer stays where it is.
function zoomBy(factor, x = canvas.clientWidth / 2, y = canvas.clientHeight / 2) {
  flight = null;
  const reach = Math.max(Math.min(camera.reach * factor, 20 * whole.radius), 1e-7 * whole.radius);
  const [right, up] = axes(), half = canvas.clientHeight / 2, lost = (camera.reach - reach) / half;
  const [across, above] = [(x - canvas.clientWidth / 2) * lost, (half - y) * lost];
  camera.target = camera.target.map((value, i) => value + across * right[i] + above * up[i]);
  camera.reach = reach;
  redraw();
}

function listen() {
  const fingers = new Map();
  let moved = 0;
  canvas.addEventListener("pointerdown", event => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, [event.offsetX, event.offsetY]);
    if (fingers.size === 1) moved = 0;
  });
  canvas.addEventListener("pointermove", event => {
    const last = fingers.get(event.pointerId);
    if (!last) return;
    const here = [event.offsetX, event.offsetY], [x, y] = sub(here, last);
    moved += Math.abs(x) + Math.abs(y);
    if (fingers.size === 2) {
      const other = [...fingers].find(([id]) => id !== event.pointerId)[1];
      zoomBy(Math.hypot(...sub(last, other)) / Math.max(Math.hypot(...sub(here, other)), 1), ...other);
      moveBy(x / 2, y / 2);
    } else if (event.shiftKey || event.buttons & 6) moveBy(x, y); else turnBy(x, y);
    fingers.set(event.pointerId, here);
  });
  for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, event => {
    fingers.delete(event.pointerId);
    if (name === "pointerup" && moved < 4 && event.button === 0) {
      const hit = pick(event.offsetX, event.offsetY);
      if (hit) select(hit.tissue, { at: hit.at, fly: false }); else letGo();
    }
  });
  canvas.addEventListener("contextmenu", event => event.preventDefault());
  canvas.addEventListener("dblclick", event => {
    const hit = pick(event.offsetX, event.offsetY);
    if (hit) flyTo({ target: hit.at });
  });
  canvas.addEventListener("wheel", event => {
    event.preventDefault();
    zoomBy(Math.exp((event.deltaMode ? 16 : 1) * event.deltaY * 0.0015), event.offsetX, event.offsetY);
  }, { passive: false });
  canvas.addEventListener("keydown", event => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const arrows = { ArrowLeft: [-12, 0], ArrowRight: [12, 0], ArrowUp: [0, -12], ArrowDown: [0, 12] }[event.key];
    const actions = {
      "+": () => zoomBy(0.8), "=": () => zoomBy(0.8), "-": () => zoomBy(1.25), f: () => fit(), e: () => byId("edges").click(),
      h: () => byId("chip-hide").click(), i: () => byId("chip-only").click(), a: () => byId("all").click(), Escape: letGo,
    };
    if (arrows) (event.shiftKey ? moveBy : turnBy)(...arrows);
    else if (actions[event.key]) actions[event.key]();
    else return;
    event.preventDefault();
  });
  document.addEventListener("click", event => {
    const button = event.target.closest("[data-finding], [data-tissue], [data-pair]");
    if (!button) return;
    if (button.dataset.finding !== undefined) show(Number(button.dataset.finding), Number(button.dataset.place ?? 0));
    else if (button.dataset.tissue !== undefined) select(Number(button.dataset.tissue));
    else showPair(button.dataset.pair);
    if (innerWidth < 1080) byId("viewer").scrollIntoView({ block: "start" });
  });
  byId("chip-close").onclick = letGo;
  byId("chip-hide").onclick = () => {
    if (state.selected === null) return;
    setShown(tissues[state.selected], false);
    letGo();
  };
  byId("chip-only").onclick = () => {
    const chosen = state.focus?.size ? state.focus : state.selected === null ? null : [state.selected];
    if (chosen) showOnly(new Set(chosen));
  };
  byId("chip-card").onclick = () => { if (state.selected !== null) openCard(state.selected); };
  const views = { front: FRONT, left: [Math.PI / 2, 0], back: [Math.PI, 0], top: [0, Math.PI / 2] };
  for (const button of document.querySelectorAll("[data-view]")) {
    button.onclick = () => { state.focus = null; fit(undefined, views[button.dataset.view]); };
  }
  byId("colour").onchange = event => {
    state.colour = event.target.value;
    byId("qkey").hidden = state.colour !== "q";
    redraw();
  };
  byId("edges").onchange = event => { state.edges = event.target.checked; redraw(); };
  byId("dots").onchange = event => { state.dots = event.target.checked; redraw(); };
  byId("opacity").oninput = event => {
    const value = Number(event.target.value) / 100;
    (state.selected === null ? tissues : [tissues[state.selected]]).forEach(tissue => { tissue.opacity = value; });
    redraw();
  };
  const cut = () => {
    const axis = byId("cut").value, at = byId("cut-at");
    at.disabled = axis === "";
    const box = boxOf(tissues);
    state.cut = axis === "" || !box ? null
      : { axis: Number(axis), at: box.low[axis] + (box.high[axis] - box.low[axis]) * Number(at.value) / 1000 };
    redraw();
  };
  byId("cut").onchange = byId("cut-at").oninput = cut;
  byId("wide").onclick = event => {
    const wide = document.documentElement.classList.toggle("is-wide");
    event.target.setAttribute("aria-pressed", wide);
  };
  byId("list-toggle").onclick = event => {
    byId("list").hidden = !byId("list").hidden;
    event.target.setAttribute("aria-expanded", !byId("list").hidden);
    if (!byId("list").hidden) byId("search").focus();
  };
  byId("all").onclick = () => showOnly(new Set(tissues.keys()));
  byId("none").onclick = () => showOnly(new Set());
  byId("search").oninput = event => {
    const wanted = event.target.value.trim().toLowerCase();
    tissues.forEach(tissue => { tissue.item.hidden = !`${tissue.name} ${tissue.type}`.toLowerCase().includes(wanted); });
  };
  document.addEventListener("vhp-theme", readGround);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", readGround);
  new ResizeObserver(redraw).observe(stage);
}

function fillList() {
  byId("names").append(...tissues.map(tissue => {
    const item = document.createElement("li"), box = document.createElement("input");
    const patch = document.createElement("i"), name = document.createElement("button");
    item.className = tissue.verdict;
    box.type = "checkbox";
    box.checked = true;
    box.disabled = !tissue.faces;
    box.setAttribute("aria-label", `Show ${tissue.name}`);
    box.onchange = () => setShown(tissue, box.checked);
    patch.className = "swatch";
    patch.style.background = `rgb(${tissue.colour.map(part => Math.round(255 * part))})`;
    name.type = "button";
    name.textContent = tissue.name;
    name.dataset.tissue = tissue.index;
    item.append(box, patch, name);
    Object.assign(tissue, { box, item });
    return item;
  }));
}

// ---- the start

function giveUp(reason) {
  byId("fallback").hidden = false;
  byId("fallback-words").textContent = `${reason} Pictures are shown instead.`;
  document.querySelector(".tools").hidden = byId("note").hidden = true;
  canvas.hidden = true;
  window.vhp.failed = reason;
}

async function start() {
  window.vhp = {
    ready: false, failed: "", tissues, findings, state, camera, select, show, letGo, fit, pick, setShown, showOnly,
    get target() { return [...camera.target]; },
    get selected() { return state.selected === null ? null : tissues[state.selected].name; },
    get shown() { return tissues.filter(tissue => tissue.shown && tissue.faces).map(tissue => tissue.name); },
    get flying() { return flight !== null; },
  };
  tissues.forEach((tissue, index) => Object.assign(tissue, { index, shown: true }));
  gl = canvas.getContext("webgl2", { antialias: true, alpha: false });
  if (!gl) { giveUp("This browser has no WebGL 2."); return; }
  if (typeof DecompressionStream === "undefined") { giveUp("This browser can't unpack the model."); return; }
  canvas.addEventListener("webglcontextlost", () => giveUp("The graphics card was lost; load the page again."));
  const corners = expand(await unpack(byId("geometry").textContent));
  byId("geometry").remove();
  whole = boxOf(tissues) ?? whole;
  for (const tissue of tissues) tissue.size = tissue.faces ? Math.hypot(...sub(tissue.max, tissue.min)) : 0;
  setUp(corners);
  readGround();
  fillList();
  listen();
  [camera.turn, camera.lean] = [0.45, 0.12];
  fit();
  if (flight) { Object.assign(camera, flight.to); flight = null; }
  draw();
  gl.finish();
  byId("fallback").hidden = true;
  // Time from the start of loading to the first picture, and that of unpacking alone, in ms.
  Object.assign(window.vhp, { ready: true, firstView: performance.now(), unpacking: performance.now() - started });
}

start().catch(error => { giveUp("The model can't be shown."); console.error(error); });
})();
