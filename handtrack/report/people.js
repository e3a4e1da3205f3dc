(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const id = (name) => document.getElementById(name);
  const world = makeWorld(data), { count } = world;
  const charts = makeCharts(id("charts"), world), { element } = charts;
  const canvas = id("view"), scene = makeScene(canvas, world, false), plan = makeScene(id("plan"), world, true);
  const layers = { ellipses: true, seen: true, truth: true, tracks: true };
  const slider = id("slider"), play = id("play"), speed = id("speed"), tip = id("tip");
  slider.max = String(count - 1);
  for (const label of document.querySelectorAll("[data-needs]")) label.hidden = !data[label.dataset.needs];

  // Whom to look at first: the true operator, or whoever is there longest; the left wrist.
  const days = (label) => { let n = 0; for (let i = 0; i < count; i++) n += world.here(label, i); return n; };
  const longest = [...data.labels].sort((a, b) => days(b) - days(a))[0];
  const real = data.truth ? data.truth.label.find((label) => data.labels.includes(label)) : undefined;
  const chosen = { label: real ?? longest ?? null, keypoint: 4 };
  const someone = chosen.label !== null;

  const rows = data.labels.map((label) => {
    const row = element("tr", id("now"), { "data-label": label });
    const head = element("th", row);
    element("i", head, { class: `chip c${data.labels.indexOf(label) % 6}` });
    head.append(`${label}`);
    row.addEventListener("click", () => pick({ label }));
    const cells = [0, 1, 2, 3].map(() => element("td", row));
    if (data.truth) cells.push(element("td", row));
    return { label, row, cells };
  });

  let frame = -1, waiting = false;
  const paint = () => {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => { waiting = false; const n = Math.max(frame, 0); scene.show(n, chosen, layers); plan.show(n, chosen, layers); });
  };
  const now = ({ label, row, cells }) => {
    const here = world.here(label, frame), tally = [0, 0, 0], off = [];
    row.classList.toggle("on", label === chosen.label);
    row.classList.toggle("away", !here);
    for (let k = 0; here && k < FILTERED; k++) {
      tally[world.status(label, frame, k)]++;
      const p = world.p(label, frame, k), t = world.truth(label, frame, k);
      if (p && t && world.status(label, frame, k) < 2) off.push(1000 * Math.hypot(p[0] - t[0], p[1] - t[1], p[2] - t[2]));
    }
    const hips = here && world.hips(label, frame);
    cells[0].textContent = hips ? `${Math.hypot(...hips).toFixed(2)} m` : "\u2013";
    for (const i of [0, 1, 2]) cells[i + 1].textContent = here ? tally[i] : "\u2013";
    if (cells[4]) cells[4].textContent = off.length ? `${(off.reduce((a, b) => a + b) / off.length).toFixed(0)} mm` : "\u2013";
  };
  const show = (wanted) => {
    const next = Math.max(0, Math.min(count - 1, wanted));
    if (next === frame) return;
    frame = next;
    slider.value = String(frame);
    charts.show(frame);
    who.show(frame);
    state();
    paint();
  };
  const state = () => {
    const s = someone ? world.status(chosen.label, frame, chosen.keypoint) : -1, word = s < 0 ? "not there" : data.statuses[s];
    id("status").textContent = word;
    id("status").style.setProperty("--now", s < 0 ? "var(--zero)" : `var(--${word})`);
    id("present").textContent = `frame ${frame * data.step}, ${data.time[frame].toFixed(2)} s`;
    rows.forEach(now);
  };
  const pick = ({ label = chosen.label, keypoint = chosen.keypoint, frame: wanted = null }) => {
    if (label !== chosen.label || keypoint !== chosen.keypoint) {
      chosen.label = label; chosen.keypoint = keypoint;
      remake();
    }
    if (wanted !== null) go(wanted);
  };
  const remake = () => {
    if (!someone) { id("charts").hidden = true; return; }
    document.documentElement.style.setProperty("--chosen", `var(--c${data.labels.indexOf(chosen.label) % 6})`);
    charts.choose(chosen);
    who.choose(chosen);
    if (frame >= 0) { charts.show(frame); who.show(frame); state(); paint(); }
  };
  const who = makeWho(id("who"), world, charts, (told) => pick(told));

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
  for (const chart of charts.built) {
    const { box, over } = chart;
    drag(box, (event) => go(charts.under(event, box)));
    box.addEventListener("pointermove", (event) => {
      const at = charts.under(event, box);
      over.hidden = false;
      over.style.left = `${charts.share(at)}%`;
      tip.replaceChildren();
      element("b", tip, {}, `frame ${at * data.step}, ${data.time[at].toFixed(2)} s`);
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

  const spot = (event, box) => { const area = box.getBoundingClientRect(); return [event.clientX - area.left, event.clientY - area.top]; };
  let last = null, moved = false;
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("pointerdown", (event) => { canvas.setPointerCapture(event.pointerId); last = event; moved = false; });
  canvas.addEventListener("pointermove", (event) => {
    if (!event.buttons || !last) { id("space").classList.toggle("chosen", scene.pick(...spot(event, canvas)) !== null); return; }
    const dx = event.clientX - last.clientX, dy = event.clientY - last.clientY;
    if (!moved && Math.hypot(dx, dy) < 3) return;
    moved = true;
    last = event;
    if (event.buttons & 2 || event.shiftKey) scene.move(dx, dy);
    else scene.turn(dx, dy);
    if (view !== "camera") look(null);
    paint();
  });
  canvas.addEventListener("pointerup", (event) => { const hit = !moved && scene.pick(...spot(event, canvas)); last = null; if (hit) pick(hit); });
  canvas.addEventListener("wheel", (event) => { event.preventDefault(); scene.zoom(Math.max(-0.3, Math.min(0.3, event.deltaY * 0.0012))); paint(); }, { passive: false });
  id("plan").addEventListener("click", (event) => { const hit = plan.pick(...spot(event, id("plan"))); if (hit) pick({ label: hit.label }); });
  for (const each of [canvas, id("plan")]) new ResizeObserver(paint).observe(each);
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
  const recolour = () => { theme.textContent = dark() ? "Light" : "Dark"; scene.read(); plan.read(); remake(); paint(); };
  theme.hidden = false;
  theme.addEventListener("click", () => { document.documentElement.dataset.theme = dark() ? "light" : "dark"; recolour(); });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", recolour);

  // A link may name a frame, a view, a person and a keypoint: report.html#frame=40&view=camera&person=1&keypoint=left wrist
  const wish = new URLSearchParams(location.hash.slice(1));
  const label = Number(wish.get("person") ?? NaN), keypoint = data.keypoints.indexOf((wish.get("keypoint") || "").replace("_", " "));
  if (data.labels.includes(label)) chosen.label = label;
  if (keypoint >= 0 && keypoint < FILTERED) chosen.keypoint = keypoint;
  if (wish.get("theme")) document.documentElement.dataset.theme = wish.get("theme");
  // Else the middle of the longest stretch in which the chosen keypoint is predicted.
  let best = [0, 0], open = null;
  for (let n = 0; n <= count; n++) {
    const predicted = n < count && someone && world.status(chosen.label, n, chosen.keypoint) === 1;
    if (predicted && open === null) open = n;
    if (!predicted && open !== null) { if (n - open > best[1] - best[0]) best = [open, n]; open = null; }
  }
  recolour();
  look(["side", "front", "camera"].includes(wish.get("view")) ? wish.get("view") : "side");
  show(wish.has("frame") ? Math.round((Number(wish.get("frame")) || 0) / data.step) : (best[0] + best[1]) >> 1);
})();
