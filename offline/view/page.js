"use strict";
// Builds the scene in meshcat's viewer, moves it, and says what was known at the time shown.
const HOLD = 2300; // three.js: a value holds until the next
const TOWARDS = [1.3, -1.3, 0.8]; // the camera, in N
const INSTANTS = 30; // at which everything must be in the picture
const ESTIMATE = "#1f5fa8", TRUTH = "#c4511d";
const scene = JSON.parse(document.getElementById("scene").textContent);
const element = (id) => document.getElementById(id);
const viewer = new MeshCat.Viewer(element("pane"));
let made = 0;

function put(path, type, geometry, material, renderOrder) {
  const id = `own${made++}`;
  const object = { metadata: { version: 4.5, type: "Object" }, geometries: [{ uuid: `${id}g`, ...geometry }],
    materials: [{ uuid: `${id}m`, ...material }],
    object: { uuid: id, type, renderOrder, geometry: `${id}g`, material: `${id}m` } };
  viewer.handle_command({ type: "set_object", path, object });
}

const coloured = (colour, opacity) => ({ color: parseInt(colour.slice(1), 16), opacity, transparent: opacity < 1 });

function add(part) {
  const material = { type: "MeshPhongMaterial", ...coloured(part.colour, part.opacity),
    depthWrite: part.opacity === 1, flatShading: true };
  put(part.path, "Mesh", triangles(part), material, 0);
  if (part.opacity === 1 || part.vertices.length !== 3 * 8) return;
  const ends = []; // corners of a box differ in one bit of their index where an edge joins them
  for (let k = 0; k < 8; k++) for (const bit of [1, 2, 4]) if (!(k & bit)) ends.push(k, k | bit);
  const edges = { ...part, faces: ends };
  put(`${part.path}/edges`, "LineSegments", triangles(edges), { type: "LineBasicMaterial", ...coloured(part.colour, 1) }, 0);
}

// Marks are seen through everything; a higher one covers a lower one.
function mark(path, radius, colour, opacity, height) {
  const material = { type: "MeshBasicMaterial", ...coloured(colour, opacity), transparent: true, depthTest: false };
  put(path, "Mesh", { type: "SphereGeometry", radius, widthSegments: 24, heightSegments: 16 }, material, height);
}

function triangles(part) {
  return { type: "BufferGeometry", data: {
    attributes: { position: { itemSize: 3, type: "Float32Array", array: part.vertices } },
    index: { type: "Uint32Array", array: part.faces } } };
}

function clip(path, times, tracks, interpolation) {
  return { path, clip: { fps: 1, name: path, duration: scene.duration_s, tracks: tracks.map(([name, type, values]) => (
    { name: `.${name}`, type, times, values, interpolation })) } };
}

function triple(values, k) {
  return values.slice(3 * k, 3 * k + 3);
}

function magnified(body, from, to) {
  // The point as far from the estimate as `to` is, times the factor of the ellipsoid.
  return body.times.flatMap((times, k) => triple(from, k).map((x, i) => x + times * (to[i] - x)));
}

function animations() {
  const found = scene.frames.map((frame) => clip(frame.path, frame.t,
    [["position", "vector", frame.p], ["quaternion", "quaternion", frame.q]]));
  for (const body of scene.bodies) {
    const size = body.semi.map((x, i) => x * body.times[Math.floor(i / 3)]);
    const path = `${body.path}/estimate ${body.name}`;
    mark(`${path}/ellipsoid`, 1, ESTIMATE, 0.4, 1);
    found.push(clip(path, body.t, [["position", "vector", body.p], ["quaternion", "quaternion", body.q],
      ["scale", "vector", size]], HOLD));
    const dot = `${body.path}/centre ${body.name}`;
    mark(dot, 0.02 * scene.reach_m, ESTIMATE, 1, 2);
    found.push(clip(dot, body.t, [["position", "vector", body.p]], HOLD));
    if (body.truth) {
      const place = `${body.path}/truth ${body.name}`;
      mark(place, 0.012 * scene.reach_m, TRUTH, 1, 3);
      found.push(clip(place, body.t, [["position", "vector", magnified(body, body.p, body.truth.p)]], HOLD));
    }
  }
  return found;
}

function rounded(value, sigma) {
  const places = Math.min(9, Math.max(0, 1 - Math.floor(Math.log10(Math.max(sigma, 1e-12)))));
  return `${value.toFixed(places)} \u00b1 ${Number(sigma.toPrecision(2))}`;
}

function words(body, t) {
  let k = body.t.findLastIndex((known) => known <= t);
  k = Math.max(k, 0);
  const com = triple(body.com, k), sigma = triple(body.sigma, k);
  const axes = com.map((x, i) => `${"xyz"[i]} ${rounded(x, sigma[i])}`).join(", ");
  const factor = body.times[k] === 1 ? "true size" : `drawn ${body.times[k].toLocaleString("en")} times`;
  const semi = triple(body.semi, k).map((x) => x.toPrecision(2)).join(", ");
  let text = `${body.name}: ${rounded(body.mass[2 * k], body.mass[2 * k + 1])} kg, centre of mass ${axes} m (1 sigma)\n`;
  text += `  ellipsoid 3 sigma, semi-axes ${semi} m, ${factor}`;
  if (body.truth) {
    const off = Math.hypot(...com.map((x, i) => x - body.truth.com[i]));
    text += `; truth ${body.truth.mass} kg, ${off.toPrecision(2)} m from the estimate`;
  }
  return body.reasons[k] ? `${text}\n  not valid: ${body.reasons[k]}` : text;
}

scene.parts.forEach(add);
viewer.handle_command({ type: "set_animation", animations: animations(), options: { play: true, repetitions: Infinity } });
for (const name of ["top_color", "bottom_color"]) {
  viewer.handle_command({ type: "set_property", path: "/Background", property: name, value: [1, 1, 1] });
}
viewer.handle_command({ type: "set_property", path: "/Grid", property: "visible", value: false });

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];

function held(body) {
  const size = Math.min(scene.reach_m, body.times.at(-1) * Math.max(...body.semi.slice(-3)));
  return { vertices: [-size, size].flatMap((off) => body.p.slice(-3).flatMap((_, i) => (
    body.p.slice(-3).map((x, k) => x + (i === k ? off : 0))))) };
}

function corners() {
  // Every vertex, and what holds the ellipsoids as they are at the end, in N at a few times.
  const found = [];
  for (const frame of scene.frames) {
    const own = scene.parts.filter((part) => part.path.startsWith(`${frame.path}/`));
    own.push(...scene.bodies.filter((body) => body.path === frame.path).map(held));
    for (let n = 0; n < INSTANTS; n++) {
      const k = Math.floor((n * (frame.t.length - 1)) / (INSTANTS - 1));
      const p = triple(frame.p, k), q = frame.q.slice(4 * k, 4 * k + 4);
      for (const part of own) for (let v = 0; 3 * v < part.vertices.length; v++) {
        const x = triple(part.vertices, v), twice = cross(q, x).map((y) => 2 * y), turned = cross(q, twice);
        found.push(x.map((y, i) => p[i] + y + q[3] * twice[i] + turned[i]));
      }
    }
  }
  return found;
}

const seen = corners();
function aim() {
  // From a fixed direction, as near as everything is in the picture at all times.
  const room = element("room"), high = Math.tan((Math.PI / 360) * viewer.camera.fov);
  const wide = (high * room.clientWidth) / room.clientHeight;
  const middle = [0, 1, 2].map((i) => seen.reduce((m, x) => [Math.min(m[0], x[i]), Math.max(m[1], x[i])], [Infinity, -Infinity]))
    .map(([low, high]) => (low + high) / 2);
  const right = cross([0, 0, 1], TOWARDS), size = Math.hypot(...right), x = right.map((y) => y / size);
  const z = TOWARDS.map((y) => y / Math.hypot(...TOWARDS)), y = cross(z, x);
  const away = 1.05 * Math.max(...seen.map((point) => {
    const r = point.map((value, i) => value - middle[i]);
    return dot(r, z) + Math.max(Math.abs(dot(r, x)) / wide, Math.abs(dot(r, y)) / high);
  }));
  const upright = ([a, b, c]) => [a, c, -b]; // the viewer's own axes
  viewer.controls.target.set(...upright(middle));
  viewer.handle_command({ type: "set_property", path: "/Cameras/default/rotated/<object>", property: "position",
    value: upright(middle.map((m, i) => m + away * z[i])) });
}

const animator = viewer.animator;
const now = () => Math.max(...animator.actions.map((action) => action.time));
function seek(t) {
  animator.pause();
  animator.seek(t);
}
element("time").max = scene.duration_s;
element("time").oninput = () => seek(Number(element("time").value));
element("play").onclick = () => (animator.playing ? animator.pause() : animator.play());
function show() {
  const t = now();
  element("time").value = t;
  element("clock").textContent = `${t.toFixed(2)} s`;
  element("now").textContent = scene.bodies.map((body) => words(body, t)).join("\n");
  element("play").textContent = animator.playing ? "Pause" : "Play";
  requestAnimationFrame(show);
}
const fit = () => viewer.set_3d_pane_size(element("room").clientWidth, element("room").clientHeight);
new ResizeObserver(fit).observe(element("room"));
window.onload = fit;
window.addEventListener("resize", () => { fit(); aim(); });
requestAnimationFrame(() => { fit(); aim(); });
requestAnimationFrame(show);
window.motion = { viewer, seek, now };
