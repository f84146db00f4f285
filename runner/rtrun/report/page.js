"use strict";
// The long-term plot, turned by dragging: every run is a curve, drawn from the farthest to the nearest.
for (const figure of document.querySelectorAll(".long-term")) {
  const data = JSON.parse(figure.dataset.plot), canvas = figure.querySelector("canvas"), pen = canvas.getContext("2d");
  const runs = data.rows.length, size = data.size, top = Math.max(1, ...data.rows.map((row) => Math.max(...row.log10)));
  let turn = -0.3, tilt = 0.35, from = null;
  const place = (x, y, z) => {
    const u = x * Math.cos(turn) - y * Math.sin(turn), v = x * Math.sin(turn) + y * Math.cos(turn);
    return [470 + 520 * u, 300 - 330 * z * Math.cos(tilt) - 520 * v * Math.sin(tilt), v];
  };
  const across = (i) => i / Math.max(1, size - 1) - 0.5, along = (k) => k / Math.max(1, runs - 1) - 0.5;
  const lift = (log) => (log + 1) / (top + 1) - 0.4;
  const stroke = (points, colour) => {
    pen.beginPath();
    points.forEach(([x, y], i) => (i ? pen.lineTo(x, y) : pen.moveTo(x, y)));
    pen.strokeStyle = colour;
    pen.stroke();
  };
  const say = (text, [x, y]) => pen.fillText(text, x, y);
  const draw = () => {
    pen.clearRect(0, 0, canvas.width, canvas.height);
    pen.font = "20px sans-serif";
    const order = [...Array(runs).keys()].sort((a, b) => place(0, along(b), 0)[2] - place(0, along(a), 0)[2]);
    for (const k of order) {
      const floor = [across(0), across(size - 1)].map((x) => place(x, along(k), lift(-1)));
      const curve = data.rows[k].log10.map((log, i) => place(across(i), along(k), lift(log)));
      pen.beginPath();
      pen.moveTo(floor[0][0], floor[0][1]);
      curve.forEach(([x, y]) => pen.lineTo(x, y));
      pen.lineTo(floor[1][0], floor[1][1]);
      pen.fillStyle = "rgba(255,255,255,.85)";
      pen.fill();
      stroke(curve, "#0072B2");
    }
    pen.fillStyle = "#222";
    for (let t = 0; t <= 4; t++) {
      const value = Math.round(data.low_us + (t / 4) * size * data.width_us);
      say(value + " us", place(t / 4 - 0.5, -0.58, lift(-1)));
    }
    for (let z = 0; z <= top; z++) say("1e" + z, place(-0.58, -0.5, lift(z)));
    say("first", place(0.56, -0.42, lift(-1)));
    if (runs > 1) say("last of " + runs, place(0.53, 0.5, lift(-1)));
  };
  canvas.addEventListener("pointerdown", (event) => { from = [event.clientX, event.clientY]; canvas.setPointerCapture(event.pointerId); });
  canvas.addEventListener("pointerup", () => { from = null; });
  canvas.addEventListener("pointercancel", () => { from = null; });
  canvas.addEventListener("pointermove", (event) => {
    if (!from) return;
    turn += (event.clientX - from[0]) / 200;
    tilt = Math.min(1.5, Math.max(0, tilt + (event.clientY - from[1]) / 200));
    from = [event.clientX, event.clientY];
    draw();
  });
  figure.classList.add("turning");
  draw();
}
