// The course of one keypoint over time, and who was seen when. Paths lie in a box of 1000 x 1000 that is stretched to its card.
const makeCharts = (place, world) => {
  const { data, count } = world;
  const BOX = 1000, first = data.time[0], span = data.time[count - 1] - first || 1;
  const x = data.time.map((t) => (BOX * (t - first)) / span);
  const element = (name, parent, attributes = {}, text = "") => {
    const made = name === "svg" || parent instanceof SVGElement ? document.createElementNS("http://www.w3.org/2000/svg", name) : document.createElement(name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    if (text) made.textContent = text;
    parent.append(made);
    return made;
  };
  const minus = (text) => text.replace("-", "\u2212");
  const round = (v) => Math.round(10 * v) / 10;
  const steps = (low, high, wanted) => {
    const raw = (high - low) / wanted, power = 10 ** Math.floor(Math.log10(raw));
    const step = [1, 2, 5, 10].map((k) => k * power).find((s) => s >= raw * 0.999), out = [];
    for (let k = Math.ceil(low / step - 1e-9); k <= high / step + 1e-9; k++) out.push(k * step);
    return { out, digits: Math.max(0, -Math.floor(Math.log10(step) + 1e-9)) };
  };
  const line = (values, y) => {
    let text = "", open = false;
    values.forEach((v, i) => {
      if (v === null) { open = false; return; }
      text += `${open ? "L" : "M"}${round(x[i])} ${round(y(v))}`;
      if (!open && (i + 1 >= count || values[i + 1] === null)) text += "h.1";
      open = true;
    });
    return text;
  };
  const dots = (values, y) => values.map((v, i) => (v === null ? "" : `M${round(x[i])} ${round(y(v))}h.1`)).join("");
  const band = (low, high, y) => {
    let text = "", from = null;
    for (let i = 0; i <= count; i++) {
      const known = i < count && low[i] !== null;
      if (known && from === null) from = i;
      if (!known && from !== null) {
        const at = [...Array(i - from).keys()].map((k) => k + from);
        text += `M${at.map((k) => `${round(x[k])} ${round(y(high[k]))}`).join("L")}L${at.reverse().map((k) => `${round(x[k])} ${round(y(low[k]))}`).join("L")}Z`;
        from = null;
      }
    }
    return text;
  };

  const card = element("section", place, { class: "card" });
  const title = element("h3", card);
  const built = ["x: to the right (m)", "y: downwards (m)", "z: away from the camera (m)", data.truth ? "Error (mm)" : "Stated uncertainty (mm)"].map((name, k) => {
    const head = element("h4", card, {}, name);
    if (k === 3) element("small", head, { id: "errors" });
    const box = element("div", card, { class: k < 3 ? "chart medium place" : "chart medium" });
    const svg = element("svg", box, { viewBox: `0 0 ${BOX} ${BOX}`, preserveAspectRatio: "none", "aria-hidden": "true" });
    return { name, box, svg, head, cursor: element("div", box, { class: "cursor" }), over: element("div", box, { class: "cursor over", hidden: "" }), ticks: [], series: [] };
  });

  const each = (make) => Array.from({ length: count }, (_, n) => make(n));
  // Draw series: kind (line, band, raw, truth, dash), colour class, values.
  const fill = (chart, series, low, high, state) => {
    chart.svg.replaceChildren();
    for (const tick of chart.ticks) tick.remove();
    chart.ticks = [];
    chart.series = series;
    const y = (v) => BOX * (1 - (v - low) / (high - low));
    let begun = 0;
    for (let i = 1; i <= count; i++) if (i === count || state[i] !== state[begun]) {
      const name = { 1: "predicted", 2: "lost" }[state[begun]];
      if (name) { const left = begun ? (x[begun - 1] + x[begun]) / 2 : 0, right = i < count ? (x[i - 1] + x[i]) / 2 : BOX; element("rect", chart.svg, { class: name, x: left, y: 0, width: Math.max(right - left, 0.5), height: BOX }); }
      begun = i;
    }
    const scale = steps(low, high, 4);
    for (const v of scale.out) {
      element("path", chart.svg, { class: "grid", d: `M0 ${round(y(v))}H${BOX}` });
      chart.ticks.push(element("span", chart.box, { class: "y", style: `top:${y(v) / 10}%` }, minus((v + 0).toFixed(scale.digits))));
    }
    const times = steps(first, first + span, 6);
    for (const t of times.out) chart.ticks.push(element("span", chart.box, { class: "x", style: `left:${(100 * (t - first)) / span}%` }, `${t.toFixed(times.digits)} s`));
    for (const { kind, colour, values, more } of series) {
      if (kind === "band") element("path", chart.svg, { class: `${colour} band`, d: band(values, more, y) });
      else if (kind === "raw") element("path", chart.svg, { class: "raw", d: dots(values, y) });
      else element("path", chart.svg, { class: `${colour} ${kind}`, d: line(values, y) });
    }
  };
  const limits = (values, zero) => {
    const known = values.flat().filter((v) => v !== null);
    let low = zero ? 0 : Math.min(...(known.length ? known : [0])), high = Math.max(...(known.length ? known : [1]));
    const pad = Math.max(0.06 * (high - low), zero ? 1 : 0.02);
    return [zero ? 0 : low - pad, high + pad];
  };

  const choose = ({ label, keypoint }) => {
    const colour = `c${data.labels.indexOf(label) % 6}`;
    title.replaceChildren();
    element("i", title, { class: `chip ${colour}` });
    title.append(`${data.keypoints[keypoint]} of person ${label}`);
    const state = each((n) => world.status(label, n, keypoint)), C = each((n) => world.covariance(label, n, keypoint));
    const at = each((n) => world.p(label, n, keypoint)), raw = each((n) => world.raw(label, n, keypoint)), truth = each((n) => world.truth(label, n, keypoint));
    const axis = (points, i) => points.map((p) => p && p[i]);
    for (const i of [0, 1, 2]) {
      const middle = axis(at, i), spread = C.map((c, n) => (c && at[n] ? 2 * Math.sqrt(c[[0, 3, 5][i]]) : null));
      const low = middle.map((v, n) => (v === null ? null : v - spread[n])), high = middle.map((v, n) => (v === null ? null : v + spread[n]));
      const real = axis(truth, i);
      const [bottom, top] = limits([middle, real, low.map((v, n) => (v === null ? null : Math.max(v, middle[n] - 0.5))), high.map((v, n) => (v === null ? null : Math.min(v, middle[n] + 0.5)))], false);
      const series = [{ kind: "band", name: "±2σ", colour, values: low, more: high }, { kind: "raw", name: "measured", colour: "raw", values: axis(raw, i) }, { kind: "line", name: "estimate", colour, values: middle }];
      if (data.truth) series.push({ kind: "truth", name: "truth", colour, values: real });
      fill(built[i], series, bottom, top, state);
    }
    const apart = (a, b) => a.map((p, n) => (p && b[n] ? 1000 * Math.hypot(p[0] - b[n][0], p[1] - b[n][1], p[2] - b[n][2]) : null));
    const stated = C.map((c, n) => (c && at[n] ? 1000 * Math.sqrt(c[0] + c[3] + c[5]) : null));
    const series = [];
    if (data.truth) series.push({ kind: "raw", name: "measured", colour: "raw", values: apart(raw, truth) });
    series.push({ kind: "rival", name: "stated", colour: "neutral", values: stated });
    if (data.truth) series.push({ kind: "line", name: "estimate", colour, values: apart(at, truth) });
    const seen = [apart(at, truth), stated.map((v, n) => (state[n] === 2 ? null : v))];
    fill(built[3], series, ...limits(seen, true), state);
    const note = document.getElementById("errors");
    note.textContent = data.truth ? " \u2003line: of the estimate; dots: of the measurement; dashes: stated, \u221a trace of the covariance" : " \u2003\u221a trace of the covariance";
  };

  const show = (frame) => { for (const chart of built) chart.cursor.style.left = `${x[frame] / 10}%`; };
  const under = (event, box) => {
    const area = box.getBoundingClientRect(), at = BOX * Math.max(0, Math.min(1, (event.clientX - area.left) / area.width));
    let low = 0, high = count - 1;
    while (high - low > 1) { const half = (low + high) >> 1; if (x[half] <= at) low = half; else high = half; }
    return at - x[low] <= x[high] - at ? low : high;
  };
  const words = (chart, series, frame) => {
    const v = series.values[frame], last = chart === built[3];
    if (v === null) return "\u2013";
    if (series.kind === "band") return `${minus(v.toFixed(3))} to ${minus(series.more[frame].toFixed(3))} m`;
    return last ? `${v.toFixed(0)} mm` : `${minus(v.toFixed(3))} m`;
  };
  return { built, choose, show, under, words, element, share: (n) => x[n] / 10 };
};

// Rows of colours: one for each person, and one for each keypoint of the chosen one.
const makeWho = (place, world, charts, told) => {
  const { data, count } = world, { element } = charts;
  const painted = (box, rows, at) => {
    const canvas = element("canvas", box), wide = Math.min(count, 1400);
    canvas.width = wide; canvas.height = 1;
    const pen = canvas.getContext("2d");
    for (let i = 0; i < wide; i++) {
      const n = Math.floor((i * count) / wide), style = at(n);
      if (!style) continue;
      pen.globalAlpha = style[1]; pen.fillStyle = style[0];
      pen.fillRect(i, 0, 1, 1);
    }
    return { box, cursor: element("div", box, { class: "cursor" }), rows };
  };
  let strips = [], buttons = [];
  const style = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
  const choose = (chosen) => {
    place.replaceChildren();
    strips = []; buttons = [];
    for (const label of data.labels) {
      const tone = data.labels.indexOf(label) % 6, colour = style(`c${tone}`);
      const button = element("button", place, { type: "button", class: `c${tone}${label === chosen.label ? " on" : ""}` });
      element("i", button, { class: "chip" });
      button.append(`person ${label}`);
      button.addEventListener("click", () => told({ label }));
      buttons.push(button);
      const row = element("div", place, { class: "row" });
      strips.push(painted(row, 1, (n) => {
        if (!world.here(label, n)) return null;
        let seen = 0;
        for (let k = 0; k < FILTERED; k++) seen += world.status(label, n, k) === 0;
        return [colour, 0.25 + (0.75 * seen) / FILTERED];
      }));
      row.addEventListener("pointerdown", (event) => told({ label, frame: charts.under(event, row) }));
    }
    element("div", place, { class: "gap" });
    const colours = data.statuses.map(style);
    for (let k = 0; k < FILTERED; k++) {
      const name = element("div", place, { class: k === chosen.keypoint ? "name on" : "name" }, data.keypoints[k]);
      const row = element("div", place, { class: "row thin" });
      strips.push(painted(row, 1, (n) => { const s = world.status(chosen.label, n, k); return s < 0 ? null : [colours[s], 0.9]; }));
      name.addEventListener("click", () => told({ keypoint: k }));
      row.addEventListener("pointerdown", (event) => told({ keypoint: k, frame: charts.under(event, row) }));
    }
  };
  const show = (frame) => { for (const strip of strips) strip.cursor.style.left = `${charts.share(frame)}%`; };
  return { choose, show };
};
