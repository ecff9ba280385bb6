// SPDX-License-Identifier: Apache-2.0
// A deformed finger, coloured by strain: faces come once for each mesh, then vertices and strain as float32. Drawn from back to
// front on a plain canvas, so that it needs no graphics card. Drag it, or use the arrow keys.

const FACES = 3;
const meshes = new Map();
let shape = null;
let [turn, tilt] = [-0.5, 0.35];

function head(message) {
  const length = new DataView(message).getUint32(1);
  return [JSON.parse(new TextDecoder().decode(new Uint8Array(message, 5, length))), 5 + length];
}

// from blue over green to red, readable in both themes
function strainColour(share, light) {
  const hue = 230 - 230 * Math.min(1, Math.max(0, share));
  return `hsl(${hue} 75% ${25 + 35 * light}%)`;
}

function draw() {
  const canvas = document.getElementById("shape");
  if (!canvas || !shape) return;
  const mesh = meshes.get(shape.mesh);
  if (!mesh) return;
  const { vertices, strain } = shape;
  const pen = canvas.getContext("2d");
  pen.clearRect(0, 0, canvas.width, canvas.height);
  const [ct, st, cp, sp] = [Math.cos(turn), Math.sin(turn), Math.cos(tilt), Math.sin(tilt)];
  const seen = new Float32Array(vertices.length);
  let [low, high] = [[1e9, 1e9], [-1e9, -1e9]];
  for (let k = 0; k < vertices.length; k += 3) {
    const [x, y, z] = [vertices[k], vertices[k + 1], vertices[k + 2]];
    const [a, b] = [ct * x + st * z, -st * x + ct * z];
    seen[k] = a;
    seen[k + 1] = cp * y - sp * b;
    seen[k + 2] = sp * y + cp * b;
    low = [Math.min(low[0], seen[k]), Math.min(low[1], seen[k + 1])];
    high = [Math.max(high[0], seen[k]), Math.max(high[1], seen[k + 1])];
  }
  const scale = Math.min((canvas.width - 40) / 0.12, (canvas.height - 40) / 0.12);
  const middle = [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2];
  const at = (node) => [canvas.width / 2 + (seen[3 * node] - middle[0]) * scale, canvas.height / 2 - (seen[3 * node + 1] - middle[1]) * scale];
  const top = Math.max(0.02, ...strain);
  const order = [];
  for (let f = 0; f < mesh.count; f += 1) {
    const q = mesh.quads.subarray(4 * f, 4 * f + 4);
    order.push([f, seen[3 * q[0] + 2] + seen[3 * q[1] + 2] + seen[3 * q[2] + 2] + seen[3 * q[3] + 2]]);
  }
  order.sort((a, b) => a[1] - b[1]);
  for (const [f] of order) {
    const q = mesh.quads.subarray(4 * f, 4 * f + 4);
    const corners = [...q].map(at);
    const normal = (corners[1][0] - corners[0][0]) * (corners[2][1] - corners[0][1]) - (corners[1][1] - corners[0][1]) * (corners[2][0] - corners[0][0]);
    const light = Math.min(1, Math.abs(normal) / (Math.hypot(corners[1][0] - corners[0][0], corners[1][1] - corners[0][1]) * Math.hypot(corners[2][0] - corners[1][0], corners[2][1] - corners[1][1]) + 1e-6));
    pen.fillStyle = !shape.converged ? "#8a8f96" : mesh.owners.length ? strainColour(strain[mesh.owners[f]] / top, light) : `hsl(28 70% ${30 + 35 * light}%)`;
    pen.strokeStyle = pen.fillStyle;
    pen.beginPath();
    corners.forEach((c, k) => (k ? pen.lineTo(...c) : pen.moveTo(...c)));
    pen.closePath();
    pen.fill();
    pen.stroke();
  }
  const said = document.getElementById("shape-said");
  if (said) said.textContent = `${shape.finger}: ${shape.pulled_mm} mm, 0 .. ${(100 * top).toFixed(1)} %, ${shape.rate} Hz ${shape.reason}`;
  canvas.dataset.number = shape.number;
  canvas.dataset.coloured = String(mesh.owners.length === mesh.count);
}

function take(message) {
  const [about, start] = head(message);
  if (new Uint8Array(message, 0, 1)[0] === FACES) {
    meshes.set(about.mesh, {
      count: about.faces,
      quads: new Uint32Array(message, start, 4 * about.faces),
      owners: new Uint32Array(message, start + 16 * about.faces, about.owners),
    });
    if (meshes.size > 8) meshes.delete(meshes.keys().next().value);
    return;
  }
  shape = { ...about, vertices: new Float32Array(message, start, 3 * about.nodes), strain: new Float32Array(message, start + 12 * about.nodes, about.hexahedra) };
  requestAnimationFrame(draw);
}

function connect() {
  const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/shapes`);
  socket.binaryType = "arraybuffer";
  socket.onmessage = ({ data }) => take(data);
  socket.onclose = () => setTimeout(connect, 1000);
}

document.addEventListener("pointermove", (event) => {
  if (!event.buttons || !event.target.closest?.("#shape")) return;
  turn += event.movementX * 0.01;
  tilt += event.movementY * 0.01;
  draw();
});
document.addEventListener("keydown", (event) => {
  if (!event.target.closest?.("#shape")) return;
  const step = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] }[event.key];
  if (!step) return;
  event.preventDefault();
  turn += step[0];
  tilt += step[1];
  draw();
});
connect();
