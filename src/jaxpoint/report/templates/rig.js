"use strict";
// Turns the cameras and the light's path by hand. Orthographic: parallel lines of the room stay parallel.
(() => {
  const scenes = JSON.parse(document.getElementById("rig-data").textContent);
  const canvas = document.getElementById("rig-view");
  const context = canvas.getContext("2d");
  const view = { scene: scenes.length - 1, yaw: -0.6, pitch: 0.45, zoom: 1 };
  const EDGES = [[0, 1], [0, 2], [0, 3], [0, 4], [1, 2], [2, 3], [3, 4], [4, 1]];

  function projector(scene) {
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    const middle = scene.low.map((low, i) => (low + scene.high[i]) / 2);
    const span = Math.hypot(...scene.low.map((low, i) => scene.high[i] - low));
    const scale = view.zoom * Math.min(0.95 * width, 1.3 * height) / span;
    const [cy, sy, cp, sp] = [Math.cos(view.yaw), Math.sin(view.yaw), Math.cos(view.pitch), Math.sin(view.pitch)];
    return (p) => {
      const [x, y, z] = p.map((value, i) => value - middle[i]);
      const [right, back] = [cy * x - sy * y, sy * x + cy * y];
      return [width / 2 + scale * right, 0.47 * height - scale * (sp * back + cp * z)];
    };
  }

  function line(a, b) {
    context.beginPath(); context.moveTo(...a); context.lineTo(...b); context.stroke();
  }

  function drawFloor(scene, at, colors) {
    const step = scene.step, z = scene.low[2];
    const marks = (axis) => {
      const found = [];
      for (let k = Math.ceil(scene.low[axis] / step); k * step <= scene.high[axis]; k++) found.push(k * step);
      return found;
    };
    context.strokeStyle = colors.line; context.lineWidth = 1; context.fillStyle = colors.muted; context.font = "11px sans-serif";
    context.textAlign = "center";
    const label = (value) => String(+value.toFixed(6));
    for (const x of marks(0)) {
      line(at([x, scene.low[1], z]), at([x, scene.high[1], z]));
      const [u, v] = at([x, scene.low[1] - step / 4, z]); context.fillText(label(x), u, v + 4);
    }
    for (const y of marks(1)) {
      line(at([scene.low[0], y, z]), at([scene.high[0], y, z]));
      const [u, v] = at([scene.low[0] - step / 4, y, z]); context.fillText(label(y), u, v + 4);
    }
    context.font = "bold 12px sans-serif";
    const unit = scene.unit === "m" ? ", m" : "";
    [["x" + unit, [scene.high[0] + step / 3, scene.low[1], z]], ["y" + unit, [scene.low[0], scene.high[1] + step / 3, z]], ["z" + unit, [scene.low[0], scene.low[1], scene.high[2] + step / 5]]]
      .forEach(([text, place]) => context.fillText(text, ...at(place)));
    line(at([scene.low[0], scene.low[1], z]), at([scene.low[0], scene.low[1], scene.high[2]]));
  }

  function draw() {
    const ratio = window.devicePixelRatio || 1, scene = scenes[view.scene], at = projector(scene);
    const css = getComputedStyle(document.documentElement);
    const colors = Object.fromEntries(["ink", "muted", "line", "faint", "accent"].map((n) => [n, css.getPropertyValue("--" + n)]));
    canvas.width = canvas.clientWidth * ratio; canvas.height = canvas.clientHeight * ratio;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    drawFloor(scene, at, colors);
    context.fillStyle = colors.accent; context.globalAlpha = 0.55;
    for (const point of scene.points) { const [u, v] = at(point); context.fillRect(u - 1, v - 1, 2, 2); }
    context.globalAlpha = 1;
    scene.cameras.forEach(({ name, color, cone }) => {
      const corners = cone.map(at);
      context.strokeStyle = context.fillStyle = color; context.lineWidth = 1.4;
      for (const [a, b] of EDGES) line(corners[a], corners[b]);
      context.globalAlpha = 0.12; context.beginPath();
      corners.slice(1).forEach((corner) => context.lineTo(...corner));
      context.fill(); context.globalAlpha = 0.35; context.setLineDash([2, 3]);
      line(corners[0], at([cone[0][0], cone[0][1], scene.low[2]]));
      context.setLineDash([]); context.globalAlpha = 1;
      context.fillStyle = colors.ink; context.font = "bold 12px sans-serif"; context.textAlign = "center";
      context.fillText(name, corners[0][0], corners[0][1] - 8);
    });
  }

  function turn(yaw, pitch) {
    view.yaw += yaw; view.pitch = Math.max(-1.55, Math.min(1.55, view.pitch + pitch)); draw();
  }
  function zoom(factor) { view.zoom = Math.max(0.3, Math.min(8, view.zoom * factor)); draw(); }

  canvas.addEventListener("pointerdown", (event) => { canvas.setPointerCapture(event.pointerId); canvas.style.cursor = "grabbing"; });
  canvas.addEventListener("pointerup", () => { canvas.style.cursor = "grab"; });
  canvas.addEventListener("pointermove", (event) => { if (event.buttons) turn(event.movementX * 0.008, event.movementY * 0.008); });
  canvas.addEventListener("keydown", (event) => {
    const steps = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] };
    if (steps[event.key]) { turn(...steps[event.key]); event.preventDefault(); }
    if (event.key === "+" || event.key === "-") zoom(event.key === "+" ? 1.2 : 1 / 1.2);
  });

  const controls = document.getElementById("rig-controls");
  function button(text, action) {
    const element = document.createElement("button");
    element.type = "button"; element.textContent = text; element.addEventListener("click", action);
    controls.append(element); return element;
  }
  const choices = scenes.length < 2 ? [] : scenes.map((scene, index) => button(scene.title, () => { view.scene = index; mark(); draw(); }));
  const mark = () => choices.forEach((choice, index) => choice.setAttribute("aria-pressed", String(index === view.scene)));
  button("From above", () => { view.yaw = 0; view.pitch = 1.55; draw(); });
  button("Side", () => { view.yaw = 0; view.pitch = 0; draw(); });
  button("+", () => zoom(1.2)).setAttribute("aria-label", "Larger");
  button("−", () => zoom(1 / 1.2)).setAttribute("aria-label", "Smaller");
  mark();
  new ResizeObserver(draw).observe(canvas);
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  window.addEventListener("beforeprint", draw);
})();
