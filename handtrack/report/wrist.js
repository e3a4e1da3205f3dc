(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const id = (name) => document.getElementById(name);
  const count = data.time.length;
  const charts = makeCharts(id("charts"), data);
  const canvas = id("view");
  let scene = null;
  try { scene = makeScene(canvas, data); } catch (problem) { console.error(problem); }
  id("nogl").hidden = scene !== null;
  const layers = { room: "glass", cloud: true, ellipsoid: true, truth: true, robot: true, sight: true };
  const slider = id("slider"), scrub = id("scrub"), play = id("play"), speed = id("speed"), tip = id("tip");
  slider.max = String(count - 1);
  for (const { word, left, right } of charts.stretches(data.status))
    charts.element("i", scrub, { style: `left:${left / 10}%;width:${(right - left) / 10}%;background:var(--${data.statuses[word]})` });
  const needle = charts.element("div", scrub, { class: "cursor" });

  // The table of what is so in this frame.
  const rows = [];
  for (const { chart } of charts.built) for (const series of chart.series) {
    const row = charts.element("tr", id("now"));
    const name = charts.element("td", row);
    charts.element("i", name, { class: `chip ${series.style.split(" ")[0]}` });
    name.append(chart.stacked ? `killed by ${series.name}` : series.name === "volume" ? "volume of the ellipsoid" : series.name === "estimate" ? "error of the estimate" : series.name === "last position held" ? "error of the last position" : `robot to ${series.name}`);
    rows.push({ cell: charts.element("td", row), chart, series });
  }

  let frame = -1, waiting = false;
  const paint = () => {
    if (waiting || !scene) return;
    waiting = true;
    requestAnimationFrame(() => { waiting = false; scene.show(Math.max(frame, 0), layers); });
  };
  const show = (wanted) => {
    const next = Math.max(0, Math.min(count - 1, wanted));
    if (next === frame) return;
    frame = next;
    slider.value = String(frame);
    needle.style.left = `${(100 * (data.time[frame] - data.time[0])) / (data.time[count - 1] - data.time[0] || 1)}%`;
    charts.show(frame);
    const status = data.statuses[data.status[frame]];
    id("status").textContent = status;
    id("status").style.setProperty("--now", `var(--${status})`);
    id("present").textContent = `frame ${frame}, ${data.time[frame].toFixed(2)} s`;
    for (const { cell, chart, series } of rows) cell.textContent = charts.words(chart, series, frame);
    paint();
  };

  // Playing follows the clock, so that a slow machine leaves frames out.
  let playing = false, begun = 0, from = 0;
  const tick = (clock) => {
    if (!playing) return;
    const time = from + (Number(speed.value) * (clock - begun)) / 1000;
    let next = frame;
    while (next < count - 1 && data.time[next + 1] <= time) next++;
    show(next);
    if (next >= count - 1) { begun = clock; from = data.time[0]; show(0); }
    requestAnimationFrame(tick);
  };
  const set = (on) => {
    playing = on && count > 1;
    play.textContent = playing ? "Pause" : "Play";
    if (playing) { begun = performance.now(); from = data.time[frame >= count - 1 ? 0 : frame]; if (frame >= count - 1) show(0); requestAnimationFrame(tick); }
  };
  const go = (wanted) => { set(false); show(wanted); };
  play.addEventListener("click", () => set(!playing));
  speed.addEventListener("change", () => playing && set(true));
  slider.addEventListener("input", () => go(Number(slider.value)));
  const drag = (box, done) => {
    box.addEventListener("pointerdown", (event) => { box.setPointerCapture(event.pointerId); done(event); });
    box.addEventListener("pointermove", (event) => event.buttons & 1 && done(event));
  };
  drag(scrub, (event) => go(charts.under(event, scrub)));
  for (const { box, over, chart } of charts.built) {
    drag(box, (event) => go(charts.under(event, box)));
    box.addEventListener("pointermove", (event) => {
      const at = charts.under(event, box);
      over.hidden = false;
      over.style.left = `${(100 * (data.time[at] - data.time[0])) / (data.time[count - 1] - data.time[0] || 1)}%`;
      tip.replaceChildren();
      charts.element("b", tip, {}, `frame ${at}, ${data.time[at].toFixed(2)} s`);
      for (const series of chart.series) {
        const line = charts.element("div", tip, { class: series.style.split(" ")[0] });
        charts.element("i", line);
        line.append(`${series.name} ${charts.words(chart, series, at)}`);
      }
      tip.hidden = false;
      const size = tip.getBoundingClientRect();
      const left = event.clientX + 16 + size.width > innerWidth ? event.clientX - 16 - size.width : event.clientX + 16;
      tip.style.left = `${Math.max(4, left)}px`;
      tip.style.top = `${Math.max(4, Math.min(innerHeight - size.height - 4, event.clientY - size.height / 2))}px`;
    });
    box.addEventListener("pointerleave", () => { over.hidden = true; tip.hidden = true; });
  }

  const buttons = [...document.querySelectorAll("[data-room]")];
  const mark = () => {
    for (const button of buttons) button.classList.toggle("on", button.dataset.room === layers.room);
    for (const button of document.querySelectorAll("[data-view=camera]")) button.classList.toggle("on", scene !== null && scene.where() === "camera");
  };
  for (const button of buttons) button.addEventListener("click", () => { layers.room = button.dataset.room; mark(); paint(); });
  for (const button of document.querySelectorAll("[data-view]"))
    button.addEventListener("click", () => { if (scene) scene.from(button.dataset.view); mark(); paint(); });
  for (const box of document.querySelectorAll("[data-layer]"))
    box.addEventListener("change", () => { layers[box.dataset.layer] = box.checked; paint(); });
  for (const label of document.querySelectorAll("[data-needs]")) label.hidden = !data[label.dataset.needs];
  if (!data.room) for (const button of buttons) button.disabled = true;

  if (scene) {
    let last = null;
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("pointerdown", (event) => { canvas.setPointerCapture(event.pointerId); last = event; });
    canvas.addEventListener("pointermove", (event) => {
      if (!event.buttons || !last) return;
      const dx = event.clientX - last.clientX, dy = event.clientY - last.clientY;
      last = event;
      if (event.buttons & 2 || event.shiftKey) scene.move(dx, dy);
      else scene.turn(dx, dy);
      mark();
      paint();
    });
    canvas.addEventListener("wheel", (event) => { event.preventDefault(); scene.zoom(Math.max(-0.3, Math.min(0.3, event.deltaY * 0.0012))); paint(); }, { passive: false });
    new ResizeObserver(paint).observe(canvas);
  }
  document.addEventListener("keydown", (event) => {
    if (event.target instanceof HTMLSelectElement || event.ctrlKey || event.metaKey || event.altKey) return;
    const step = { ArrowLeft: -1, ArrowRight: 1, PageUp: -30, PageDown: 30 }[event.key];
    if (step) { event.preventDefault(); go(frame + step); }
    else if (event.key === "Home") go(0);
    else if (event.key === "End") go(count - 1);
    else if (event.key === " " && !(event.target instanceof HTMLButtonElement) && !(event.target instanceof HTMLInputElement && event.target.type === "checkbox")) { event.preventDefault(); set(!playing); }
  });

  const theme = id("theme");
  const dark = () => (document.documentElement.dataset.theme || (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light")) === "dark";
  const name = () => (theme.textContent = dark() ? "Light" : "Dark");
  const recolour = () => { name(); if (scene) scene.read(); paint(); };
  theme.hidden = false;
  name();
  theme.addEventListener("click", () => { document.documentElement.dataset.theme = dark() ? "light" : "dark"; recolour(); });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", recolour);

  // A link may name a frame and a view: report.html#frame=40&view=camera
  const wish = new URLSearchParams(location.hash.slice(1));
  if (scene && wish.get("view")) scene.from(wish.get("view"));
  if (["glass", "solid", "off"].includes(wish.get("room"))) layers.room = wish.get("room");
  mark();
  const hiddenFirst = data.hidden.indexOf(1);
  show(wish.has("frame") ? Number(wish.get("frame")) || 0 : Math.min(count - 1, Math.max(0, hiddenFirst) + (hiddenFirst > 0 ? 8 : 0)));
})();
