// The page "Try it": the package's own C on a recording into which the reader throws outliers.
(async () => {
  "use strict";
  const TOP = 20, MARGIN = { left: 34, bottom: 34 };
  const bytes = Uint8Array.from(atob(LIVE.wasm), (letter) => letter.charCodeAt(0));
  const c = (await WebAssembly.instantiate(bytes)).instance.exports;

  // The structures of live.h: F, Q, H, R and the threshold; x and P. Ours begin where C's own data end.
  const heap = new Float64Array(c.memory.buffer), MODEL = 12, THRESHOLD = 11, STATE = 6;
  const model = c.__heap_base.value, state = model + 8 * MODEL, z = state + 8 * STATE;
  const copy = (to, from, count) => heap.copyWithin(to / 8, from / 8, from / 8 + count);

  // Position after each measurement. With an infinite threshold the filter is the Kalman filter.
  function positions(measured, threshold) {
    copy(model, c.live_default.value, MODEL);
    copy(state, c.live_start.value, STATE);
    heap[model / 8 + THRESHOLD] = threshold;
    return measured.map((value) => {
      heap[z / 8] = value;
      if (c.live_predict(model, state) !== 0 || c.live_update(model, state, z, 0) !== 0) {
        throw new Error("the filter refused a sample");
      }
      return heap[state / 8];
    });
  }

  const root = document.getElementById("live"), canvas = root.querySelector("canvas"), pen = canvas.getContext("2d");
  const slider = root.querySelector("input"), said = root.querySelector("output");
  const steps = LIVE.truth.length;
  let measured = [...LIVE.measured];

  const error = (found) => Math.sqrt(found.reduce((sum, x, k) => sum + (x - LIVE.truth[k]) ** 2, 0) / steps);
  const width = () => canvas.clientWidth - MARGIN.left - 8, height = () => canvas.clientHeight - MARGIN.bottom - 8;
  const across = (k) => MARGIN.left + (k * width()) / (steps - 1);
  const down = (x) => 8 + ((TOP - x) * height()) / (2 * TOP);

  function line(values, colour, thickness, dashes) {
    pen.beginPath();
    values.forEach((x, k) => pen.lineTo(across(k), down(x)));
    pen.strokeStyle = colour;
    pen.lineWidth = thickness;
    pen.setLineDash(dashes);
    pen.stroke();
    pen.setLineDash([]);
  }

  function axes(colour) {
    pen.fillStyle = colour;
    pen.font = "12px sans-serif";
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    [-20, -10, 0, 10, 20].forEach((x) => pen.fillText(x, MARGIN.left - 6, down(x)));
    pen.textAlign = "center";
    pen.textBaseline = "top";
    [0, 20, 40, 60, 80, 100].forEach((k) => pen.fillText(k, across(k), down(-TOP) + 5));
    pen.fillText("time in s, position in m", MARGIN.left + width() / 2, down(-TOP) + 19);
    line([0, 0].flatMap((x) => Array(steps / 2).fill(x)), colour + "40", 1, []);
  }

  function draw() {
    const style = getComputedStyle(root);
    const [ink, muted, red, blue] = ["ink", "muted", "kalman", "robust"].map((name) => style.getPropertyValue(`--${name}`));
    const threshold = Number(slider.value);
    const kalman = positions(measured, Infinity), robust = positions(measured, threshold);
    const sharp = window.devicePixelRatio || 1;
    canvas.width = canvas.clientWidth * sharp;
    canvas.height = canvas.clientHeight * sharp;
    pen.setTransform(sharp, 0, 0, sharp, 0, 0);
    axes(muted);
    line(LIVE.truth, muted + "70", 6, []);
    line(kalman, red, 2, [6, 4]);
    line(robust, blue, 2, []);
    measured.forEach((x, k) => {
      const [a, b] = [across(k), down(x)], thrown = x !== LIVE.clean[k];
      pen.strokeStyle = thrown ? ink : muted;
      pen.lineWidth = thrown ? 2 : 1;
      pen.beginPath();
      if (thrown) {
        pen.moveTo(a - 4, b - 4); pen.lineTo(a + 4, b + 4);
        pen.moveTo(a - 4, b + 4); pen.lineTo(a + 4, b - 4);
      } else {
        pen.arc(a, b, 2, 0, 2 * Math.PI);
      }
      pen.stroke();
    });
    root.querySelector("#live-threshold").textContent = threshold.toFixed(2);
    said.textContent = `Root-mean-square error: Kalman ${error(kalman).toFixed(2)} m, robust ${error(robust).toFixed(2)} m`;
  }

  canvas.addEventListener("pointerdown", (event) => {
    const box = canvas.getBoundingClientRect();
    const k = Math.round(((event.clientX - box.left - MARGIN.left) * (steps - 1)) / width());
    measured[Math.min(Math.max(k, 0), steps - 1)] = TOP - ((event.clientY - box.top - 8) * 2 * TOP) / height();
    draw();
  });
  root.querySelector("#live-more").addEventListener("click", () => {
    for (let i = 0; i < 10; i++) {
      measured[Math.floor(Math.random() * steps)] = TOP * (2 * Math.random() - 1);
    }
    draw();
  });
  root.querySelector("#live-none").addEventListener("click", () => { measured = [...LIVE.clean]; draw(); });
  root.querySelector("#live-first").addEventListener("click", () => { measured = [...LIVE.measured]; draw(); });
  slider.addEventListener("input", draw);
  new ResizeObserver(draw).observe(canvas);
  new MutationObserver(draw).observe(document.body, { attributes: true, attributeFilter: ["data-theme"] });
})();
