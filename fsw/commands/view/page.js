"use strict";
// Builds the scene in meshcat's viewer, moves it, and says what was known at the time shown.
const HOLD = 2300; // three.js: a value holds until the next
const ESTIMATE = "#1f5fa8", TRUTH = "#c4511d";
const scene = JSON.parse(document.getElementById("scene").textContent);
const element = (id) => document.getElementById(id);
const viewer = new MeshCat.Viewer(element("pane"));
let made = 0;

function add(path, geometry, colour, opacity) {
  const id = `own${made++}`;
  const material = { uuid: `${id}m`, type: "MeshPhongMaterial", color: parseInt(colour.slice(1), 16),
    opacity, transparent: opacity < 1, depthWrite: opacity === 1, flatShading: true };
  const object = { metadata: { version: 4.5, type: "Object" }, geometries: [{ uuid: `${id}g`, ...geometry }],
    materials: [material], object: { uuid: id, type: "Mesh", geometry: `${id}g`, material: `${id}m` } };
  viewer.handle_command({ type: "set_object", path, object });
}

function triangles(part) {
  return { type: "BufferGeometry", data: {
    attributes: { position: { itemSize: 3, type: "Float32Array", array: part.vertices } },
    index: { type: "Uint32Array", array: part.faces } } };
}

const sphere = (radius) => ({ type: "SphereGeometry", radius, widthSegments: 24, heightSegments: 16 });

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
    add(`${path}/ellipsoid`, sphere(1), ESTIMATE, 0.4);
    found.push(clip(path, body.t, [["position", "vector", body.p], ["quaternion", "quaternion", body.q],
      ["scale", "vector", size]], HOLD));
    const dot = `${body.path}/centre ${body.name}`;
    add(dot, sphere(0.008 * scene.reach_m), ESTIMATE, 1);
    found.push(clip(dot, body.t, [["position", "vector", body.p]], HOLD));
    if (body.truth) {
      const place = `${body.path}/truth ${body.name}`;
      add(place, sphere(0.008 * scene.reach_m), TRUTH, 1);
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

for (const part of scene.parts) add(part.path, triangles(part), part.colour, part.opacity);
viewer.handle_command({ type: "set_animation", animations: animations(), options: { play: true, repetitions: Infinity } });
for (const name of ["top_color", "bottom_color"]) {
  viewer.handle_command({ type: "set_property", path: "/Background", property: name, value: [1, 1, 1] });
}
viewer.handle_command({ type: "set_property", path: "/Grid", property: "visible", value: false });
const away = 0.75 * scene.reach_m;
viewer.handle_command({ type: "set_property", path: "/Cameras/default/rotated/<object>", property: "position",
  value: [1.3 * away, 0.8 * away, 1.3 * away] });

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
window.addEventListener("resize", fit);
requestAnimationFrame(fit);
requestAnimationFrame(show);
window.motion = { viewer, seek, now };
