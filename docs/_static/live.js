// The page "Try it": the package's own C on a recording into which the reader throws outliers.
(async () => {
  "use strict";
  const TOP = 20, MARGIN = { left: 34, bottom: 34 };
  const packed = Uint8Array.from(atob(LIVE.wasm), (letter) => letter.charCodeAt(0));
  const unpacked = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  const bytes = await new Response(unpacked).arrayBuffer();
  const math = { log: Math.log, exp: Math.exp, hypot: Math.hypot };
  const c = (await WebAssembly.instantiate(bytes, { env: math })).instance.exports;
  const heap = new Float64Array(c.memory.buffer), Z = c.live_z.value / 8, POSITION = c.live_position.value / 8;

  const root = document.getElementById("live"), canvas = root.querySelector("canvas"), pen = canvas.getContext("2d");
  const sliders = [...root.querySelectorAll("input")], [told, slider] = sliders, said = root.querySelector("output");
  const steps = LIVE.truth.length;
  let measured = [...LIVE.measured];

  // Position after each measurement.
  function positions(filter, ...options) {
    heap.set(measured, Z);
    if (filter(steps, ...options) !== steps) throw new Error("the filter refused a sample");
    return [...heap.slice(POSITION, POSITION + steps)];
  }

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
    const names = ["ink", "muted", "kalman", "robust", "learnt"];
    const [ink, muted, red, blue, green] = names.map((name) => style.getPropertyValue(`--${name}`));
    const threshold = Number(slider.value), R = 10 ** Number(told.value);
    const kalman = positions(c.live_kalman, R), robust = positions(c.live_default, R, threshold);
    const learnt = positions(c.live_learnt, R);
    const sharp = window.devicePixelRatio || 1;
    canvas.width = canvas.clientWidth * sharp;
    canvas.height = canvas.clientHeight * sharp;
    pen.setTransform(sharp, 0, 0, sharp, 0, 0);
    axes(muted);
    line(LIVE.truth, muted + "70", 6, []);
    line(kalman, red, 2, [6, 4]);
    line(robust, blue, 2, []);
    line(learnt, green, 2, [2, 2]);
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
    root.querySelector("#live-told").textContent = R < 1 ? R.toFixed(2) : R.toFixed(R < 10 ? 1 : 0);
    const errors = [kalman, robust, learnt].map((found) => error(found).toFixed(2));
    said.textContent = `Root-mean-square error: Kalman ${errors[0]} m, default ${errors[1]} m, learnt noise ${errors[2]} m`;
  }

  // A reading goes where the pointer is, and each that it is dragged across, however few events tell of that.
  function pointed(event) {
    const box = canvas.getBoundingClientRect();
    const k = Math.round(((event.clientX - box.left - MARGIN.left) * (steps - 1)) / width());
    const x = TOP - ((event.clientY - box.top - 8) * 2 * TOP) / height();
    return { k: Math.min(Math.max(k, 0), steps - 1), x: Math.min(Math.max(x, -TOP), TOP) };
  }
  let before = null;
  function spoil(event) {
    const at = pointed(event), from = before || at;
    for (let k = at.k; k !== from.k; k += Math.sign(from.k - at.k)) {
      measured[k] = at.x + ((from.x - at.x) * (k - at.k)) / (from.k - at.k);
    }
    measured[at.k] = at.x;
    before = at;
    draw();
  }
  canvas.addEventListener("pointerdown", (event) => { before = null; spoil(event); });
  canvas.addEventListener("pointermove", (event) => { if (event.buttons) spoil(event); });
  root.querySelector("#live-more").addEventListener("click", () => {
    for (let i = 0; i < 10; i++) {
      measured[Math.floor(Math.random() * steps)] = TOP * (2 * Math.random() - 1);
    }
    draw();
  });
  root.querySelector("#live-none").addEventListener("click", () => { measured = [...LIVE.clean]; draw(); });
  root.querySelector("#live-first").addEventListener("click", () => {
    measured = [...LIVE.measured];
    sliders.forEach((one) => { one.value = one.defaultValue; });
    draw();
  });
  sliders.forEach((one) => one.addEventListener("input", draw));
  new ResizeObserver(draw).observe(canvas);
  new MutationObserver(draw).observe(document.body, { attributes: true, attributeFilter: ["data-theme"] });
})();
