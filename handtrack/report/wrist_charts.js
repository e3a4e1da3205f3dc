// Curves over time: paths in a box of 1000 x 1000 that is stretched to the card; words beside it are HTML.
const makeCharts = (place, data) => {
  const count = data.time.length, first = data.time[0], span = data.time[count - 1] - first || 1;
  const BOX = 1000;
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
  // Stretches of frames with the same word, each reaching half way to its neighbours.
  const stretches = (words) => {
    const out = [];
    for (let i = 0; i < count; i++) {
      const left = i ? (x[i - 1] + x[i]) / 2 : 0, right = i + 1 < count ? (x[i] + x[i + 1]) / 2 : BOX;
      const last = out[out.length - 1];
      if (last && last.word === words[i]) last.right = right;
      else out.push({ word: words[i], left, right });
    }
    return out;
  };
  const steps = (low, high, wanted) => {
    const raw = (high - low) / wanted, power = 10 ** Math.floor(Math.log10(raw));
    const step = [1, 2, 5, 10].map((k) => k * power).find((s) => s >= raw * 0.999);
    const out = [];
    for (let k = Math.ceil(low / step - 1e-9); k <= high / step + 1e-9; k++) out.push(k * step);
    return { out, digits: Math.max(0, -Math.floor(Math.log10(step) + 1e-9)) };
  };
  const pathOf = (values, y) => {
    let text = "", open = false;
    values.forEach((v, i) => {
      if (v === null) { open = false; return; }
      text += `${open ? "L" : "M"}${round(x[i])} ${round(y(v))}`;
      if (!open && (i + 1 >= count || values[i + 1] === null)) text += "h.1";
      open = true;
    });
    return text;
  };
  const areaOf = (low, high, y) => `M${high.map((v, i) => `${round(x[i])} ${round(y(v))}`).join("L")}L${low.map((v, i) => `${round(x[i])} ${round(y(v))}`).reverse().join("L")}Z`;
  const scaleOf = (chart, values) => {
    const known = values.flat().filter((v) => v !== null);
    let low = Math.min(...(known.length ? known : [0])), high = Math.max(...(known.length ? known : [1]));
    if (chart.log) {
      low = Math.floor(Math.log10(low)); high = Math.ceil(Math.log10(high)); if (high <= low) high = low + 1;
      const ticks = []; for (let k = low; k <= high; k++) ticks.push([k, 10 ** k]);
      const every = Math.ceil(ticks.length / 5);
      return { y: (v) => BOX * (1 - (Math.log10(v) - low) / (high - low)), ticks: ticks.filter((_, k) => k % every === 0).map(([k, v]) => [BOX * (1 - (k - low) / (high - low)), k < 0 ? v.toFixed(-k) : `${v}`]) };
    }
    low = Math.min(0, low); high = Math.max(high, low + 1e-3) + 0.05 * (high - low);
    const { out, digits } = steps(low, high, 4);
    const y = (v) => BOX * (1 - (v - low) / (high - low));
    return { y, ticks: out.map((v) => [y(v), minus((v + 0).toFixed(digits))]) };
  };

  const built = data.charts.map((chart) => {
    const card = element("section", place, { class: "card" });
    const head = element("h3", card, {}, chart.unit ? `${chart.name} (${chart.unit})` : chart.name);
    for (const series of chart.series) {
      const key = element("small", head, { class: series.style });
      element("i", key, { class: series.style });
      key.append(series.name);
    }
    const box = element("div", card, { class: "chart" });
    const svg = element("svg", box, { viewBox: `0 0 ${BOX} ${BOX}`, preserveAspectRatio: "none", "aria-hidden": "true" });
    for (const { word, left, right } of stretches(data.hidden)) if (word) element("rect", svg, { class: "hidden", x: left, y: 0, width: right - left, height: BOX });
    for (const { word, left, right } of stretches(data.status)) {
      const name = data.statuses[word];
      if (name === "uncertain" || name === "lost") element("rect", svg, { class: name, x: left, y: 0, width: right - left, height: BOX });
    }
    const sums = [data.time.map(() => 0)];
    if (chart.stacked) for (const series of chart.series) sums.push(series.values.map((v, i) => v + sums[sums.length - 1][i]));
    const scale = scaleOf(chart, chart.stacked ? sums : chart.series.map((s) => s.values));
    for (const [at, text] of scale.ticks) {
      element("path", svg, { class: "grid", d: `M0 ${round(at)}H${BOX}` });
      element("span", box, { class: "y", style: `top:${at / 10}%` }, text);
    }
    const { out, digits } = steps(first, first + span, 6);
    for (const t of out) element("span", box, { class: "x", style: `left:${(100 * (t - first)) / span}%` }, `${t.toFixed(digits)} s`);
    chart.series.forEach((series, k) => {
      if (chart.stacked) element("path", svg, { class: series.style, d: areaOf(sums[k], sums[k + 1], scale.y) });
      else element("path", svg, { class: `${series.style} line`, d: pathOf(series.values, scale.y) });
    });
    return { chart, box, cursor: element("div", box, { class: "cursor" }), over: element("div", box, { class: "cursor over", hidden: "" }) };
  });

  const show = (frame) => { for (const each of built) each.cursor.style.left = `${x[frame] / 10}%`; };
  const nearest = (share) => {
    const at = share * BOX;
    let low = 0, high = count - 1;
    while (high - low > 1) { const half = (low + high) >> 1; if (x[half] <= at) low = half; else high = half; }
    return at - x[low] <= x[high] - at ? low : high;
  };
  const under = (event, box) => {
    const area = box.getBoundingClientRect();
    return nearest(Math.max(0, Math.min(1, (event.clientX - area.left) / area.width)));
  };
  const words = (chart, series, frame) => {
    const v = series.values[frame];
    return v === null ? "\u2013" : `${minus(chart.log ? `${Number(v.toPrecision(3))}` : v.toFixed(chart.digits))}${chart.unit ? ` ${chart.unit}` : ""}`;
  };
  return { built, show, under, stretches, element, words };
};
