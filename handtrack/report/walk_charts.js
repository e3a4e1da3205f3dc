// Errors, headings and joints over time. Paths lie in a box of 1000 x 1000 that is stretched to its card.
const makeCharts = (place, world) => {
  const { data, count, ours, raw, truth } = world;
  const BOX = 1000, first = data.time[0], span = data.time[count - 1] - first || 1;
  const x = data.time.map((t) => (BOX * (t - first)) / span);
  const element = (name, parent, attributes = {}, text = "") => {
    const made = name === "svg" || parent instanceof SVGElement ? document.createElementNS("http://www.w3.org/2000/svg", name) : document.createElement(name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    if (text) made.textContent = text;
    parent.append(made);
    return made;
  };
  const minus = (text) => text.replace(/-/g, "\u2212");
  const round = (v) => Math.round(10 * v) / 10;
  const steps = (low, high, wanted) => {
    const rough = (high - low) / wanted, power = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 5, 10].map((k) => k * power).find((s) => s >= rough * 0.999), out = [];
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
  const band = (low, high, y) => {
    let text = "", from = null;
    for (let i = 0; i <= count; i++) {
      const known = i < count && low[i] !== null && high[i] !== null;
      if (known && from === null) from = i;
      if (!known && from !== null) {
        const at = [...Array(i - from).keys()].map((k) => k + from);
        text += `M${at.map((k) => `${round(x[k])} ${round(y(high[k]))}`).join("L")}L${at.reverse().map((k) => `${round(x[k])} ${round(y(low[k]))}`).join("L")}Z`;
        from = null;
      }
    }
    return text;
  };

  const each = (make) => Array.from({ length: count }, (_, n) => make(n));
  const combine = (a, b, make) => a.map((v, n) => (v === null || b[n] === null ? null : make(v, b[n])));
  const around = (values, spread) => ({ values: combine(values, spread, (v, s) => v - 2 * s), more: combine(values, spread, (v, s) => v + 2 * s) });
  // Spans in which something holds, as shares of the box.
  const shade = (svg, name, holds) => {
    let begun = null;
    for (let i = 0; i <= count; i++) {
      const on = i < count && holds(i);
      if (on && begun === null) begun = i;
      if (!on && begun !== null) {
        const left = begun ? (x[begun - 1] + x[begun]) / 2 : 0, right = i < count ? (x[i - 1] + x[i]) / 2 : BOX;
        element("rect", svg, { class: name, x: left, y: 0, width: Math.max(right - left, 0.5), height: BOX });
        begun = null;
      }
    }
  };
  // Series: kind (line, band, beside, rival, truth), colour class, values; `free` ones do not stretch the scale.
  const limits = (chart) => {
    const known = chart.series.filter((s) => !s.free).flatMap((s) => (s.more ? [...s.values, ...s.more] : s.values)).filter((v) => v !== null);
    known.sort((a, b) => a - b);
    const low = known.length ? known[Math.floor(0.002 * known.length)] : 0, high = known.length ? known[Math.min(known.length - 1, Math.ceil(0.998 * known.length))] : 1;
    const pad = Math.max(0.08 * (high - low), chart.least);
    return [chart.zero ? 0 : low - pad, high + pad];
  };
  const fill = (chart) => {
    chart.svg.replaceChildren();
    for (const tick of chart.ticks) tick.remove();
    chart.ticks = [];
    const [low, high] = limits(chart), y = (v) => BOX * (1 - (v - low) / (high - low));
    shade(chart.svg, "blind", world.blind);
    for (const name of ["uncertain", "lost"]) shade(chart.svg, name, (n) => data.statuses[world.status(n)] === name);
    const scale = steps(low, high, 4);
    for (const v of scale.out) {
      element("path", chart.svg, { class: "grid", d: `M0 ${round(y(v))}H${BOX}` });
      chart.ticks.push(element("span", chart.box, { class: "y", style: `top:${y(v) / 10}%` }, minus((v + 0).toFixed(scale.digits))));
    }
    const times = steps(first, first + span, 6);
    for (const t of times.out) chart.ticks.push(element("span", chart.box, { class: "x", style: `left:${(100 * (t - first)) / span}%` }, `${t.toFixed(times.digits)} s`));
    for (const { kind, colour, values, more } of chart.series) element("path", chart.svg, { class: `${colour} ${kind}`, d: kind === "band" ? band(values, more, y) : line(values, y) });
  };

  const axis = (of, i, unit = 1) => each((n) => { const p = of.pelvis(n); return p && unit * p[i]; });
  const sigma = (i, unit = 1) => each((n) => { const s = world.sigma(n); return s && unit * s[i]; });
  const apart = (of) => each((n) => { const p = of.pelvis(n), t = truth.pelvis(n); return p && t && 1000 * Math.hypot(...vec.sub(p, t)); });
  const stated = each((n) => { const s = world.sigma(n); return s && 2000 * Math.hypot(...s); });
  const unwrap = (values, like) => { let turns = 0, last = null; return values.map((v, n) => { if (v === null) return null; const near = like ? like[n] : last; if (near !== null && near !== undefined) turns = Math.round((near - v) / 360); last = v + 360 * turns; return last; }); };

  const charts = [];
  const add = (title, note, unit, digits, series, more = {}) => charts.push({ title, note, unit, digits, series, least: 1, zero: false, tall: true, ...more });
  const zeros = each(() => 0);
  if (truth) {
    const error = apart(ours);
    add("Error of the pelvis (mm)", "line: followed; band: up to 2\u03c3; brown: suit alone, where it fits in", "mm", 0, [
      { kind: "band", name: "2\u03c3", colour: "c0", values: zeros, more: stated },
      ...(raw ? [{ kind: "beside", name: "suit alone", colour: "raw-name", values: apart(raw), free: true }] : []),
      { kind: "line", name: "followed", colour: "c0", values: error },
    ], { zero: true });
    if (raw) add("Beside the suit alone (mm)", "", "mm", 0, [{ kind: "beside", name: "suit alone", colour: "raw-name", values: apart(raw) }, { kind: "line", name: "followed", colour: "c0", values: error }], { zero: true, tall: false });
    for (const i of [0, 1, 2]) {
      const off = combine(axis(ours, i, 1000), axis(truth, i, 1000), (a, b) => a - b), s = sigma(i, 1000);
      add(`Off along ${"xyz"[i]} (mm)`, i ? "" : "followed less truth, \u00b12\u03c3 about zero", "mm", 0, [{ kind: "band", name: "\u00b12\u03c3", colour: "c0", ...around(zeros, s) }, { kind: "line", name: "off", colour: "c0", values: off }], { tall: false });
    }
    const wrap = (v) => ((((v + 180) % 360) + 360) % 360) - 180;
    const turn = (of) => each((n) => { const a = of.heading(n), b = truth.heading(n); return a === null || b === null ? null : wrap(a - b); });
    add("Heading off (\u00b0)", "", "\u00b0", 1, [
      { kind: "band", name: "\u00b12\u03c3", colour: "c0", ...around(zeros, each(world.sigmaHeading)) },
      ...(raw ? [{ kind: "beside", name: "suit alone", colour: "raw-name", values: turn(raw), free: true }] : []),
      { kind: "line", name: "off", colour: "c0", values: turn(ours) },
    ], { tall: false, least: 0.2 });
  } else {
    add("Stated uncertainty, 2\u03c3 (mm)", "twice the square root of the three variances' sum", "mm", 0, [{ kind: "line", name: "2\u03c3", colour: "c0", values: stated }], { zero: true });
    for (const i of [0, 1, 2]) {
      const values = axis(ours, i);
      add(`${"xyz"[i]} (m)`, i ? "" : "followed, \u00b12\u03c3; brown: suit alone", "m", 3, [
        { kind: "band", name: "\u00b12\u03c3", colour: "c0", ...around(values, sigma(i)) },
        ...(raw ? [{ kind: "beside", name: "suit alone", colour: "raw-name", values: axis(raw, i) }] : []),
        { kind: "line", name: "followed", colour: "c0", values },
      ], { tall: false, least: 0.02 });
    }
    const heading = unwrap(each(ours.heading));
    add("Heading (\u00b0)", "", "\u00b0", 1, [
      { kind: "band", name: "\u00b12\u03c3", colour: "c0", ...around(heading, each(world.sigmaHeading)) },
      ...(raw ? [{ kind: "beside", name: "suit alone", colour: "raw-name", values: unwrap(each(raw.heading), heading) }] : []),
      { kind: "line", name: "followed", colour: "c0", values: heading },
    ], { tall: false });
  }
  const joint = data.joints.length ? { title: "Joint (\u00b0)", note: "angle, \u00b12\u03c3", unit: "\u00b0", digits: 1, series: [], least: 1, zero: false, tall: true } : null;
  if (joint) charts.push(joint);

  const card = element("section", place, { class: "card" });
  element("h3", card, {}, "Over time");
  const built = charts.map((chart) => {
    const head = element("h4", card, {}, chart.title);
    if (chart.note) element("small", head, {}, chart.note);
    const box = element("div", card, { class: chart.tall ? "chart medium" : "chart medium place" });
    const svg = element("svg", box, { viewBox: `0 0 ${BOX} ${BOX}`, preserveAspectRatio: "none", "aria-hidden": "true" });
    return Object.assign(chart, { head, box, svg, cursor: element("div", box, { class: "cursor" }), over: element("div", box, { class: "cursor over", hidden: "" }), ticks: [] });
  });
  const choose = (j) => {
    const values = each((n) => world.joint(n, j));
    joint.series = [{ kind: "band", name: "\u00b12\u03c3", colour: "c2", ...around(values, each((n) => world.sigmaJoint(n, j))) }, { kind: "line", name: data.joints[j], colour: "c2", values }];
    fill(joint);
  };
  if (joint) {
    const select = element("select", joint.head, { "aria-label": "Joint" });
    data.joints.forEach((name, j) => element("option", select, { value: j }, name));
    select.addEventListener("change", () => choose(Number(select.value)));
    const start = Math.max(0, data.joints.indexOf("right elbow"));
    select.value = String(start);
    choose(start);
  }
  for (const chart of built) if (chart !== joint) fill(chart);

  const show = (frame) => { for (const chart of built) chart.cursor.style.left = `${x[frame] / 10}%`; };
  const under = (event, box) => {
    const area = box.getBoundingClientRect(), at = BOX * Math.max(0, Math.min(1, (event.clientX - area.left) / area.width));
    let low = 0, high = count - 1;
    while (high - low > 1) { const half = (low + high) >> 1; if (x[half] <= at) low = half; else high = half; }
    return at - x[low] <= x[high] - at ? low : high;
  };
  const words = (chart, series, frame) => {
    const v = series.values[frame], w = series.more ? series.more[frame] : null, text = (value) => minus(value.toFixed(chart.digits));
    if (v === null) return "\u2013";
    return w === null ? `${text(v)} ${chart.unit}` : `${text(v)} to ${text(w)} ${chart.unit}`;
  };
  return { built, show, under, words, element, share: (n) => x[n] / 10 };
};
