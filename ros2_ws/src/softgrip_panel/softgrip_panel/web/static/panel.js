// SPDX-License-Identifier: Apache-2.0
// Stop, live data and theme. The stop is a request of its own, so that neither this page's websockets nor a redraw hold it up.

const PICTURE = 1;
const TENSIONS = 2;
const byId = (id) => document.getElementById(id);
const colour = (name) => getComputedStyle(document.body).getPropertyValue(name).trim() || "#888";

function sayStop(text) {
  let box = byId("estop-said");
  if (!box) {
    box = document.createElement("div");
    box.id = "estop-said";
    box.setAttribute("role", "alert");
    document.body.append(box);
  }
  box.textContent = text;
  clearTimeout(box.timer);
  box.timer = setTimeout(() => box.remove(), 15000);
}

async function stop() {
  sayStop("...");
  try {
    const answer = await fetch("/act/estop", { method: "POST", signal: AbortSignal.timeout(6000) });
    const said = answer.headers.get("content-type")?.includes("json") ? await answer.json() : { text: await answer.text() };
    sayStop(said.text);
  } catch (error) {
    sayStop(`${error}. ${byId("lost")?.textContent ?? ""}`);
  }
}

const isDark = () => document.body.classList.contains("body--dark");

function wantsDark() {
  const chosen = localStorage.getItem("softgrip_theme");
  return chosen ? chosen === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
}

function setTheme(dark) {
  window.Quasar?.Dark?.set(dark);
  document.body.classList.toggle("body--dark", dark);
  document.body.classList.toggle("body--light", !dark);
  drawTensions();
  drawCheck();
  if (byId("curve")) drawGrasp(byId("curve"));
}

async function copyCommand(button) {
  const code = button.parentElement.querySelector("code");
  try {
    await navigator.clipboard.writeText(code.textContent);
    const word = button.textContent;
    button.textContent = button.dataset.copied;
    setTimeout(() => (button.textContent = word), 2000);
  } catch {
    getSelection().selectAllChildren(code); // a browser that does not let pages copy: it is selected instead
  }
}

document.addEventListener("click", (event) => {
  if (event.target.closest("#estop")) stop();
  const copy = event.target.closest(".copy");
  if (copy) copyCommand(copy);
  if (event.target.closest("#theme")) {
    localStorage.setItem("softgrip_theme", isDark() ? "light" : "dark");
    setTheme(wantsDark());
  }
});

// --- camera: the picture, then what the model predicts and what the markers show

async function drawPicture(message) {
  const canvas = byId("camera");
  if (!canvas) return;
  const length = new DataView(message).getUint32(1);
  const head = JSON.parse(new TextDecoder().decode(new Uint8Array(message, 5, length)));
  const image = await createImageBitmap(new Blob([new Uint8Array(message, 5 + length)], { type: "image/jpeg" }));
  const scale = Math.min(1, 960 / image.width);
  const [width, height] = [Math.round(image.width * scale), Math.round(image.height * scale)];
  if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
  const pen = canvas.getContext("2d");
  pen.drawImage(image, 0, 0, width, height);
  image.close();
  for (const [name, points] of Object.entries(head.lines)) drawChain(pen, points, scale, colour(`--overlay-${name}`), name === "predicted");
  canvas.dataset.number = head.number;
  canvas.dataset.lines = Object.keys(head.lines).join(" ");
  byId("no-picture")?.remove();
}

function drawChain(pen, points, scale, style, dashed) {
  if (!points.length) return;
  pen.strokeStyle = pen.fillStyle = style;
  pen.lineWidth = 3;
  pen.setLineDash(dashed ? [9, 5] : []);
  pen.beginPath();
  points.forEach(([u, v], k) => (k ? pen.lineTo(u * scale, v * scale) : pen.moveTo(u * scale, v * scale)));
  pen.stroke();
  pen.setLineDash([]);
  for (const [u, v] of points) {
    pen.beginPath();
    pen.arc(u * scale, v * scale, 4, 0, 2 * Math.PI);
    pen.fill();
  }
}

// --- tensions: a bar each, with a mark where free motion would be, and the last half minute

const history = [];
const HISTORY = 300;

let newest = { rows: [], stale: true };

function takeTensions(message) {
  newest = JSON.parse(new TextDecoder().decode(new Uint8Array(message, 1)));
  history.push(newest.rows);
  if (history.length > HISTORY) history.shift();
  takeClosing(newest.rows);
  drawTensions();
  drawCheck();
}

function drawTensions() {
  const { rows, stale } = newest;
  const canvas = byId("tensions");
  if (!canvas) return;
  const ratio = window.devicePixelRatio || 1;
  const [width, height] = [canvas.clientWidth, Math.max(60, 62 * rows.length)];
  if (canvas.width !== width * ratio || canvas.height !== height * ratio) [canvas.width, canvas.height] = [width * ratio, height * ratio];
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  const top = Math.max(10, ...history.flatMap((one) => one.map((row) => Math.max(row[1] ?? 0, row[2] ?? 0))));
  pen.font = "14px system-ui, sans-serif";
  rows.forEach(([name, tension, free, pulled], k) => {
    const y = 62 * k;
    const half = width * 0.5;
    pen.fillStyle = colour(stale ? "--warn" : "--text");
    const show = (value) => (value === null ? "?" : value.toFixed(1));
    pen.fillText(`${name}  ${show(tension)} N  (${show(free)} N)  ${show(pulled)} mm`, 0, y + 15);
    pen.strokeStyle = colour("--line");
    pen.strokeRect(0.5, y + 22.5, half - 10, 22);
    pen.fillStyle = colour("--accent");
    pen.fillRect(1, y + 23, Math.max(0, ((tension ?? 0) / top) * (half - 11)), 21);
    if (free !== null) {
      pen.fillStyle = colour("--measured");
      pen.fillRect(Math.max(0, (free / top) * (half - 11)) - 1, y + 19, 3, 29);
    }
    curve(pen, history.map((one) => one[k]?.[1]), half, y + 4, width - half, 46, top, colour("--accent"));
    curve(pen, history.map((one) => one[k]?.[2]), half, y + 4, width - half, 46, top, colour("--measured"));
  });
  canvas.dataset.rows = rows.length;
}

function curve(pen, values, x, y, width, height, top, style) {
  pen.strokeStyle = style;
  pen.lineWidth = 1.5;
  pen.beginPath();
  let open = false;
  values.forEach((value, k) => {
    if (value === null || value === undefined) {
      open = false;
      return;
    }
    const at = [x + (k / HISTORY) * width, y + height - (Math.max(0, value) / top) * height];
    if (open) pen.lineTo(...at);
    else pen.moveTo(...at);
    open = true;
  });
  pen.stroke();
}

// --- the empty closing: tension over pulled length, beside what the finger's own record says

const closing = new Map();
const resting = new Set();
const REST_MM = 0.3; // pulled less, a finger is open

function takeClosing(rows) {
  for (const [name, tension, , pulled] of rows) {
    const dots = closing.get(name) ?? [];
    closing.set(name, dots);
    if (tension === null || pulled === null) continue;
    // a closing stays to be looked at until the next one begins
    if (pulled < REST_MM) resting.add(name);
    else if (resting.delete(name)) dots.length = 0;
    if (!resting.has(name)) dots.push([pulled, tension]);
    if (dots.length > 400) dots.shift();
  }
}

function drawCheck() {
  const canvas = byId("check");
  if (!canvas) return;
  const { rows } = newest;
  const pen = canvas.getContext("2d");
  const records = [...document.querySelectorAll("#check-curves li")];
  const curves = new Map(records.map((one) => [one.dataset.slot, (one.dataset.curve || "").split(" ").filter(Boolean).map((pair) => pair.split(",").map(Number))]));
  pen.clearRect(0, 0, canvas.width, canvas.height);
  const all = [...curves.values(), ...closing.values()].flat();
  const [right, top] = [Math.max(16, ...all.map(([x]) => x)), Math.max(10, ...all.map(([, n]) => n))];
  const height = canvas.height / Math.max(1, rows.length);
  const drawn = {}; // slot: points of the record, dots of now
  pen.font = "16px system-ui, sans-serif";
  rows.forEach(([name], k) => {
    const place = ([x, n]) => [50 + (x / right) * (canvas.width - 60), (k + 1) * height - 16 - (Math.max(0, n) / top) * (height - 36)];
    pen.fillStyle = colour("--text");
    pen.fillText(`${name}  0 .. ${right.toFixed(0)} mm, 0 .. ${top.toFixed(0)} N`, 4, k * height + 18);
    pen.strokeStyle = colour("--line");
    pen.strokeRect(50, k * height + 20, canvas.width - 60, height - 36);
    pen.strokeStyle = colour("--measured");
    pen.lineWidth = 2;
    pen.beginPath();
    (curves.get(name) ?? []).forEach((point, j) => (j ? pen.lineTo(...place(point)) : pen.moveTo(...place(point))));
    pen.stroke();
    pen.fillStyle = colour("--accent");
    for (const point of closing.get(name)) pen.fillRect(place(point)[0] - 2, place(point)[1] - 2, 4, 4);
    drawn[name] = [(curves.get(name) ?? []).length, closing.get(name).length];
  });
  canvas.dataset.drawn = JSON.stringify(drawn);
}

// --- one grasp: tensions over time

const TENDON_STYLES = ["--accent", "--measured", "--good", "--bad"];

function drawGrasp(canvas) {
  canvas.drawn = canvas.dataset.curve;
  const { tendons, samples, decided } = JSON.parse(canvas.dataset.curve);
  const pen = canvas.getContext("2d");
  pen.clearRect(0, 0, canvas.width, canvas.height);
  const [left, bottom] = [44, canvas.height - 24];
  const end = Math.max(1, samples.length ? samples[samples.length - 1][0] : 1, decided ?? 0);
  const top = Math.max(10, ...samples.flatMap((one) => one.slice(1)).map((n) => n ?? 0));
  const place = (s, n) => [left + (s / end) * (canvas.width - left - 8), bottom - (Math.max(0, n) / top) * (bottom - 30)];
  pen.font = "15px system-ui, sans-serif";
  pen.strokeStyle = colour("--line");
  pen.strokeRect(left, 26, canvas.width - left - 8, bottom - 26);
  pen.fillStyle = colour("--text");
  pen.fillText(`${top.toFixed(0)} N`, 0, 40);
  pen.fillText(`${end.toFixed(1)} s`, canvas.width - 52, canvas.height - 6);
  tendons.forEach((name, k) => {
    pen.strokeStyle = pen.fillStyle = colour(TENDON_STYLES[k % TENDON_STYLES.length]);
    pen.fillText(name, left + 110 * k, 18);
    for (const [column, dash] of [[1 + k, []], [1 + tendons.length + k, [6, 5]]]) {
      pen.setLineDash(dash);
      pen.lineWidth = dash.length ? 1.5 : 2.5;
      pen.beginPath();
      samples.filter((one) => one[column] !== null).forEach((one, j) => (j ? pen.lineTo(...place(one[0], one[column])) : pen.moveTo(...place(one[0], one[column]))));
      pen.stroke();
    }
  });
  pen.setLineDash([]);
  if (decided !== null) {
    pen.strokeStyle = colour("--text");
    pen.beginPath();
    pen.moveTo(place(decided, 0)[0], 26);
    pen.lineTo(place(decided, 0)[0], bottom);
    pen.stroke();
  }
}

setInterval(() => {
  const canvas = byId("curve");
  if (canvas && canvas.drawn !== canvas.dataset.curve) drawGrasp(canvas);
}, 200);

// --- the live socket

function connect() {
  const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/live`);
  socket.binaryType = "arraybuffer";
  let latest = null;
  socket.onopen = () => document.body.classList.remove("disconnected");
  socket.onmessage = ({ data }) => {
    const kind = new Uint8Array(data, 0, 1)[0];
    if (kind === TENSIONS) takeTensions(data);
    if (kind === PICTURE) {
      const idle = latest === null;
      latest = data;
      if (idle) requestAnimationFrame(() => { const next = latest; latest = null; drawPicture(next); });
    }
  };
  socket.onclose = (event) => {
    if (event.code === 4401) location.assign("/login");
    document.body.classList.add("disconnected");
    setTimeout(connect, 1000);
  };
}

setTheme(wantsDark());
// Quasar starts after this script, and follows the computer instead of what was chosen here
new MutationObserver(() => isDark() !== wantsDark() && setTheme(wantsDark())).observe(document.body, { attributeFilter: ["class"] });
connect();
