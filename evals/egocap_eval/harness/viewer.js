// A skeleton to turn and to scrub through: truth in blue, prediction in orange, on a 2-D canvas.
"use strict";
const $ = id => document.getElementById(id);
const scene = $("scene"), strip = $("strip"), slider = $("frame"), pen = scene.getContext("2d");
let motion, frame = 0, turn = 0.7, tilt = 0.25, zoom = 1.35, playing = null;

function decoded(text) {  // base64 of little-endian 16-bit millimetres
  const bytes = Uint8Array.from(atob(text), c => c.charCodeAt(0));
  return new Int16Array(bytes.buffer);
}

function choose(index) {
  motion = motions[index];
  motion.points ??= {truth: decoded(motion.truth), predicted: decoded(motion.predicted)};
  slider.max = motion.frames - 1;
  show(Math.min(frame, motion.frames - 1));
  drawStrip();
}

function fit(canvas) {  // one canvas pixel a screen pixel
  const ratio = window.devicePixelRatio || 1, height = parseInt(canvas.getAttribute("height0") || canvas.height);
  canvas.setAttribute("height0", height);
  canvas.width = canvas.clientWidth * ratio;
  canvas.height = height * ratio;
  canvas.style.height = height + "px";
  canvas.getContext("2d").setTransform(ratio, 0, 0, ratio, 0, 0);
  return [canvas.clientWidth, height];
}

function projected(points, j, width, height) {
  const at = (frame * 18 + j) * 3, mm = points.slice(at, at + 3);
  if (mm[0] === -32768) return null;  // not predicted
  const x = mm[0] / 1000, y = mm[1] / 1000, z = mm[2] / 1000 + 0.75;  // turn about the waist
  const c = Math.cos(turn), s = Math.sin(turn), a = Math.cos(tilt), b = Math.sin(tilt);
  const right = s * x - c * y, ahead = c * x + s * y;
  const up = a * z - b * ahead, near = a * ahead + b * z;
  const scale = zoom * height * 1.25 / (3.2 - near);
  return [width / 2 + scale * right, height / 2 - scale * up, near];
}

function skeleton(points, colour, width, height, thick) {
  const at = [...Array(18).keys()].map(j => projected(points, j, width, height));
  pen.strokeStyle = pen.fillStyle = colour;
  pen.lineWidth = thick; pen.lineCap = "round";
  for (const [i, j] of bones) {
    if (!at[i] || !at[j]) continue;
    pen.beginPath(); pen.moveTo(at[i][0], at[i][1]); pen.lineTo(at[j][0], at[j][1]); pen.stroke();
  }
  for (const p of at) {
    if (!p) continue;
    pen.beginPath(); pen.arc(p[0], p[1], thick * 1.1, 0, 7); pen.fill();
  }
  return at;
}

function draw() {
  const [width, height] = fit(scene);
  pen.clearRect(0, 0, width, height);
  const t = skeleton(motion.points.truth, "#3b6ea8", width, height, 3);
  const p = skeleton(motion.points.predicted, "#d98032", width, height, 3);
  pen.strokeStyle = "rgba(181,73,91,.55)"; pen.lineWidth = 1;
  for (let j = 0; j < 18; j++) if (t[j] && p[j]) {
    pen.beginPath(); pen.moveTo(t[j][0], t[j][1]); pen.lineTo(p[j][0], p[j][1]); pen.stroke();
  }
}

function drawStrip() {
  const [width, height] = fit(strip), ink = strip.getContext("2d");
  ink.clearRect(0, 0, width, height);
  const most = Math.max(...motion.errors, 1e-9);
  ink.fillStyle = "#c9d6e4";
  motion.errors.forEach((e, i) => {
    const x = i * width / motion.frames, h = (height - 2) * e / most;
    ink.fillRect(x, height - h, Math.max(width / motion.frames, 1), h);
  });
  ink.fillStyle = "#b5495b";
  ink.fillRect((frame + 0.5) * width / motion.frames - 1, 0, 2, height);
}

function show(index) {
  frame = index;
  slider.value = index;
  const e = motion.errors[index];
  $("said").textContent = `frame ${index * motion.step}, ${(index * motion.step / motion.fps).toFixed(2)} s: ` +
    (e < 0 ? "not predicted" : `${e.toFixed(1)} mm`);
  draw(); drawStrip();
}

function play() {
  if (playing) { clearInterval(playing); playing = null; $("play").textContent = "Play"; return; }
  $("play").textContent = "Stop";
  playing = setInterval(() => show((frame + 1) % motion.frames), 1000 * motion.step / motion.fps);
}

$("which").onchange = e => choose(+e.target.value);
slider.oninput = () => show(+slider.value);
$("play").onclick = play;
strip.onclick = e => show(Math.min(Math.floor(e.offsetX / strip.clientWidth * motion.frames), motion.frames - 1));
const held = new Map();
scene.onpointerdown = e => { held.set(e.pointerId, e); scene.setPointerCapture(e.pointerId); };
scene.onpointerup = scene.onpointercancel = e => held.delete(e.pointerId);
scene.onpointermove = e => {
  const before = held.get(e.pointerId);
  if (!before) return;
  if (held.size === 2) {
    const other = [...held.values()].find(o => o.pointerId !== e.pointerId);
    const apart = p => Math.hypot(p.clientX - other.clientX, p.clientY - other.clientY);
    zoom *= apart(e) / Math.max(apart(before), 1);
  } else {
    turn += (e.clientX - before.clientX) / 150;
    tilt = Math.max(-1.4, Math.min(1.4, tilt + (e.clientY - before.clientY) / 150));
  }
  held.set(e.pointerId, e);
  draw();
};
scene.addEventListener("wheel", e => { e.preventDefault(); zoom *= Math.exp(-e.deltaY / 800); draw(); }, {passive: false});
window.addEventListener("resize", () => { draw(); drawStrip(); });
choose(0);
