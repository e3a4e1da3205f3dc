(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const id = (name) => document.getElementById(name);
  const world = makeWorld(data), { count, ours, truth } = world;
  const charts = makeCharts(id("charts"), world), { element } = charts;
  const canvas = id("view"), scene = makeScene(canvas, world, false), plan = makeScene(id("plan"), world, true);
  const layers = { ellipses: true, raw: true, truth: true, seen: true };
  const slider = id("slider"), play = id("play"), speed = id("speed"), trail = id("trail"), tip = id("tip");
  slider.max = String(count - 1);
  for (const each of document.querySelectorAll("[data-needs]")) each.hidden = !data[each.dataset.needs];

  // Spans of the states under the slider.
  const band = id("band");
  let begun = 0;
  for (let n = 1; n <= count; n++) if (n === count || world.status(n) !== world.status(begun)) {
    const left = begun ? (charts.share(begun - 1) + charts.share(begun)) / 2 : 0, right = n < count ? (charts.share(n - 1) + charts.share(n)) / 2 : 100;
    element("i", band, { style: `left:${left}%;width:${Math.max(right - left, 0.1)}%;background:var(--${data.statuses[world.status(begun)]})` });
    begun = n;
  }
  const hand = element("div", band, { class: "cursor" });

  const cells = [["followed", ours], ["\u00b12\u03c3", null], ["suit alone", world.raw], ["truth", truth]].filter(([, of], i) => i === 1 || of).map(([name, of]) => {
    const row = element("tr", id("now"));
    element("th", row, {}, name);
    return { of, cells: Array.from({ length: truth ? 5 : 4 }, () => element("td", row)) };
  });
  const minus = (text) => text.replace("-", "\u2212");
  const now = (frame) => {
    for (const { of, cells: row } of cells) {
      const p = of ? of.pelvis(frame) : world.sigma(frame), turn = of ? of.heading(frame) : world.sigmaHeading(frame), real = truth && truth.pelvis(frame);
      for (const i of [0, 1, 2]) row[i].textContent = p ? minus((of ? p[i] : 2 * p[i]).toFixed(3)) + " m" : "\u2013";
      row[3].textContent = turn === null ? "\u2013" : `${minus((of ? turn : 2 * turn).toFixed(1))}\u00b0`;
      if (row[4]) row[4].textContent = of && of !== truth && p && real ? `${(1000 * Math.hypot(...vec.sub(p, real))).toFixed(0)} mm` : "";
    }
  };

  let frame = -1, waiting = false;
  const paint = () => {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => { waiting = false; const n = Math.max(frame, 0), long = trail.value === "all" ? null : Number(trail.value); scene.show(n, layers, long); plan.show(n, layers, long); });
  };
  const show = (wanted) => {
    const next = Math.max(0, Math.min(count - 1, wanted));
    if (next === frame) return;
    frame = next;
    slider.value = String(frame);
    charts.show(frame);
    hand.style.left = `${charts.share(frame)}%`;
    const word = data.statuses[world.status(frame)];
    id("status").textContent = world.blind(frame) ? `${word}, out of view` : word;
    id("status").style.setProperty("--now", `var(--${word})`);
    id("present").textContent = `frame ${data.frame[frame]}, ${data.time[frame].toFixed(2)} s`;
    now(frame);
    paint();
  };

  // Playing follows the clock, so that a slow machine leaves frames out.
  let playing = false, started = 0, from = 0;
  const tick = (clock) => {
    if (!playing) return;
    const time = from + (Number(speed.value) * (clock - started)) / 1000;
    let next = frame;
    while (next < count - 1 && data.time[next + 1] <= time) next++;
    show(next);
    if (next >= count - 1) { started = clock; from = data.time[0]; show(0); }
    requestAnimationFrame(tick);
  };
  const set = (on) => {
    playing = on && count > 1;
    play.textContent = playing ? "Pause" : "Play";
    if (playing) { if (frame >= count - 1) show(0); started = performance.now(); from = data.time[frame]; requestAnimationFrame(tick); }
  };
  const go = (wanted) => { set(false); show(wanted); };
  play.addEventListener("click", () => set(!playing));
  speed.addEventListener("change", () => playing && set(true));
  slider.addEventListener("input", () => go(Number(slider.value)));
  trail.addEventListener("change", paint);
  const drag = (box, done) => {
    box.addEventListener("pointerdown", (event) => { box.setPointerCapture(event.pointerId); done(event); });
    box.addEventListener("pointermove", (event) => event.buttons & 1 && done(event));
  };
  drag(band, (event) => go(charts.under(event, band)));
  for (const chart of charts.built) {
    const { box, over } = chart;
    drag(box, (event) => go(charts.under(event, box)));
    box.addEventListener("pointermove", (event) => {
      const at = charts.under(event, box);
      over.hidden = false;
      over.style.left = `${charts.share(at)}%`;
      tip.replaceChildren();
      element("b", tip, {}, `frame ${data.frame[at]}, ${data.time[at].toFixed(2)} s`);
      for (const series of chart.series) {
        const line = element("div", tip, { class: series.colour });
        element("i", line);
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

  let view = "side";
  const look = (name) => {
    view = name;
    if (name) scene.from(name);
    for (const button of document.querySelectorAll("[data-view]")) button.classList.toggle("on", button.dataset.view === name);
    paint();
  };
  for (const button of document.querySelectorAll("[data-view]")) button.addEventListener("click", () => look(button.dataset.view));
  for (const box of document.querySelectorAll("[data-layer]"))
    box.addEventListener("change", () => { layers[box.dataset.layer] = box.checked; paint(); });

  let last = null;
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("pointerdown", (event) => { canvas.setPointerCapture(event.pointerId); last = event; });
  canvas.addEventListener("pointermove", (event) => {
    if (!event.buttons || !last) return;
    const dx = event.clientX - last.clientX, dy = event.clientY - last.clientY;
    last = event;
    if (event.buttons & 2 || event.shiftKey) { scene.move(dx, dy); if (view === "follow") look(null); }
    else { scene.turn(dx, dy); if (view === "side") look(null); }
    paint();
  });
  canvas.addEventListener("pointerup", () => { last = null; });
  canvas.addEventListener("wheel", (event) => { event.preventDefault(); scene.zoom(Math.max(-0.3, Math.min(0.3, event.deltaY * 0.0012))); paint(); }, { passive: false });
  id("plan").addEventListener("click", (event) => { const area = id("plan").getBoundingClientRect(), hit = plan.pick(event.clientX - area.left, event.clientY - area.top); if (hit !== null) go(hit); });
  for (const each of [canvas, id("plan")]) new ResizeObserver(paint).observe(each);
  document.addEventListener("keydown", (event) => {
    if (event.target instanceof HTMLSelectElement || event.ctrlKey || event.metaKey || event.altKey) return;
    const step = { ArrowLeft: -1, ArrowRight: 1, PageUp: -25, PageDown: 25 }[event.key];
    if (step) { event.preventDefault(); go(frame + step); }
    else if (event.key === "Home") go(0);
    else if (event.key === "End") go(count - 1);
    else if (event.key === " " && !(event.target instanceof HTMLButtonElement) && !(event.target instanceof HTMLInputElement && event.target.type === "checkbox")) { event.preventDefault(); set(!playing); }
  });

  const theme = id("theme");
  const dark = () => (document.documentElement.dataset.theme || (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light")) === "dark";
  const recolour = () => { theme.textContent = dark() ? "Light" : "Dark"; scene.read(); plan.read(); paint(); };
  theme.hidden = false;
  theme.addEventListener("click", () => { document.documentElement.dataset.theme = dark() ? "light" : "dark"; recolour(); });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", recolour);

  // A link may name a frame, a view and how much of the path is shown: report.html#frame=40&view=camera&shown=all
  const wish = new URLSearchParams(location.hash.slice(1));
  if (wish.get("theme")) document.documentElement.dataset.theme = wish.get("theme");
  if (["10", "30", "all"].includes(wish.get("shown"))) trail.value = wish.get("shown");
  // Else the end of the longest stretch out of view.
  let best = [0, -1], open = null;
  for (let n = 0; n <= count; n++) {
    const blind = n < count && world.blind(n);
    if (blind && open === null) open = n;
    if (!blind && open !== null) { if (n - 1 - open > best[1] - best[0]) best = [open, n - 1]; open = null; }
  }
  const named = wish.has("frame") ? data.frame.findIndex((n) => n >= (Number(wish.get("frame")) || 0)) : -1;
  recolour();
  look(["side", "follow", "camera"].includes(wish.get("view")) ? wish.get("view") : "side");
  show(named >= 0 ? named : best[1] >= 0 ? best[1] : Math.min(count - 1, 50));
})();
