"use strict";
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const count = data.frame.length;
  const first = data.time[0];
  const span = data.time[count - 1] - first || 1;
  const video = document.getElementById("video");
  const tip = document.getElementById("tip");
  const scrub = document.getElementById("scrub");
  const charts = [...document.querySelectorAll(".chart")];
  const rows = [...document.querySelectorAll(".now tr[data-chart]")];
  const cursors = [];
  const hovers = [];

  const add = (parent, name, list) => {
    const line = document.createElement("div");
    line.className = name;
    parent.append(line);
    list.push(line);
  };
  for (const box of [...charts, scrub]) add(box, "cursor", cursors);
  for (const box of charts) add(box, "cursor over", hovers);
  for (const line of hovers) line.hidden = true;

  const left = (index) => `${(100 * (data.time[index] - first)) / span}%`;
  const minus = (text) => text.replace("-", "\u2212");
  const write = (value, unit, digits = 2) => (value === null || value === undefined ? "\u2013" : minus(value.toFixed(digits)) + unit);

  const difference = (value, truth, unit) => {
    if (value === null || truth === null || truth === undefined) return null;
    const gap = value - truth;
    return unit === "\u00b0" ? ((((gap + 180) % 360) + 360) % 360) - 180 : gap;
  };

  // The frame whose time is nearest; times rise, so halving finds it.
  const nearest = (time) => {
    let low = 0;
    let high = count - 1;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (data.time[middle] <= time) low = middle;
      else high = middle;
    }
    return time - data.time[low] <= data.time[high] - time ? low : high;
  };

  let present = -1;
  const show = (index) => {
    index = Math.max(0, Math.min(count - 1, index));
    if (index === present) return;
    present = index;
    const x = left(index);
    for (const line of cursors) line.style.left = x;
    const status = document.getElementById("status");
    status.textContent = data.status[index];
    status.style.setProperty("--now", `var(--${data.status[index]})`);
    document.getElementById("present").textContent = `frame ${data.frame[index]}, ${data.time[index].toFixed(2)} s`;
    for (const row of rows) {
      const chart = data.charts[row.dataset.chart];
      const series = chart.series[row.dataset.series];
      const cells = row.children;
      const value = series.v[index];
      cells[1].textContent = write(value, chart.unit);
      cells[2].textContent = write(series.s[index], chart.unit, 3);
      if (cells.length > 3) {
        cells[3].textContent = write(series.t && series.t[index], chart.unit);
        cells[4].textContent = write(difference(value, series.t && series.t[index], chart.unit), chart.unit, 3);
      }
    }
  };

  const go = (index) => {
    index = Math.max(0, Math.min(count - 1, index));
    if (video) video.currentTime = (index + 0.5) / data.fps;
    show(index);
  };

  const under = (event, box) => {
    const area = box.getBoundingClientRect();
    const share = Math.max(0, Math.min(1, (event.clientX - area.left) / area.width));
    return nearest(first + share * span);
  };

  const line = (series, chart, index) => {
    const item = document.createElement("div");
    const chip = document.createElement("i");
    chip.className = series.style;
    const value = document.createElement("b");
    value.textContent = write(series.v[index], chart.unit);
    const note = document.createElement("small");
    if (series.s) note.textContent += `  sigma ${write(series.s[index], chart.unit, 3)}`;
    if (series.t) note.textContent += `  true ${write(series.t[index], chart.unit)}`;
    item.append(chip, `${series.name} `, value, " ", note);
    return item;
  };

  const explain = (event, box) => {
    const index = under(event, box);
    for (const mark of hovers) {
      mark.hidden = false;
      mark.style.left = left(index);
    }
    const chart = data.charts[box.dataset.chart];
    const head = document.createElement("small");
    head.textContent = `frame ${data.frame[index]}, ${data.time[index].toFixed(2)} s, ${data.status[index]}`;
    tip.replaceChildren(head, ...chart.series.map((series) => line(series, chart, index)));
    tip.hidden = false;
    const { width, height } = tip.getBoundingClientRect();
    const x = event.clientX + 18 + width > innerWidth ? event.clientX - 18 - width : event.clientX + 18;
    tip.style.left = `${Math.max(4, x)}px`;
    tip.style.top = `${Math.max(4, Math.min(innerHeight - height - 4, event.clientY - height / 2))}px`;
  };

  const quiet = () => {
    tip.hidden = true;
    for (const mark of hovers) mark.hidden = true;
  };

  for (const box of [...charts, scrub]) {
    let held = false;
    box.addEventListener("pointerdown", (event) => {
      held = true;
      if (video) video.pause();
      go(under(event, box));
    });
    box.addEventListener("pointermove", (event) => {
      if (held && event.buttons) go(under(event, box));
      if (box !== scrub) explain(event, box);
    });
    box.addEventListener("pointerup", () => (held = false));
    box.addEventListener("pointerleave", () => {
      held = false;
      quiet();
    });
  }
  addEventListener("scroll", quiet, { passive: true });

  if (video) {
    const follow = (time) => show(Math.floor(time * data.fps + 1e-3));
    if (video.requestVideoFrameCallback) {
      const onFrame = (_, meta) => {
        follow(meta.mediaTime + 0.5 / data.fps);
        video.requestVideoFrameCallback(onFrame);
      };
      video.requestVideoFrameCallback(onFrame);
    } else {
      const tick = () => {
        if (!video.paused) follow(video.currentTime);
        requestAnimationFrame(tick);
      };
      requestAnimationFrame(tick);
      video.addEventListener("seeked", () => follow(video.currentTime));
    }
  }

  addEventListener("keydown", (event) => {
    if (event.target.closest("button, input, video") || event.ctrlKey || event.metaKey || event.altKey) return;
    const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (step) {
      if (video) video.pause();
      go(present + step);
    } else if (event.key === " " && video) {
      if (video.paused) video.play();
      else video.pause();
    } else return;
    event.preventDefault();
  });

  const theme = document.getElementById("theme");
  const dark = () =>
    (document.documentElement.dataset.theme || (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light")) === "dark";
  const name = () => (theme.textContent = dark() ? "Light" : "Dark");
  theme.hidden = false;
  name();
  theme.addEventListener("click", () => {
    document.documentElement.dataset.theme = dark() ? "light" : "dark";
    name();
  });

  show(0);
})();
