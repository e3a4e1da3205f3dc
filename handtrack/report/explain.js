"use strict";
(() => {
  const all = (selector, root = document) => [...root.querySelectorAll(selector)];
  const chosen = document.getElementById("chosen");
  for (const item of all(".sorting, .zoom")) item.hidden = false;

  // One sampler: its card, large, beside the image.
  const choose = (name) => {
    const card = document.getElementById(name);
    if (!card) return;
    for (const item of all(".on")) item.classList.remove("on");
    card.classList.add("on");
    for (const mark of all(`[data-s="${name}"]`)) mark.classList.add("on");
    const copy = card.cloneNode(true);
    copy.removeAttribute("id");
    copy.classList.remove("on");
    chosen.replaceChildren(copy);
    chosen.parentElement.hidden = false;
  };
  for (const mark of all("[data-s]")) {
    mark.addEventListener("click", () => choose(mark.dataset.s));
    mark.addEventListener("pointerenter", (event) => event.buttons || choose(mark.dataset.s));
  }
  for (const card of all(".cards .card")) card.addEventListener("click", () => choose(card.id));

  // Links: a finding or a row of a table lights its links in the image.
  const light = (links) => {
    document.body.classList.toggle("dim", links.length > 0);
    for (const item of all(".scene [data-link]")) item.classList.toggle("lit", links.includes(item.dataset.link));
  };
  for (const item of all(".findings li, .facts-table tr[data-link]")) {
    const links = (item.dataset.links ?? item.dataset.link ?? "").split(" ").filter(Boolean);
    if (!links.length) continue;
    item.addEventListener("pointerenter", () => light(links));
    item.addEventListener("pointerleave", () => light([]));
  }

  // Sorting and choosing cards.
  const sort = document.getElementById("sort");
  const link = document.getElementById("link");
  const outcome = document.getElementById("outcome");
  const arrange = () => {
    const key = sort.value;
    for (const box of all(".cards")) {
      const cards = all(".card", box);
      const size = (card) => (key === "link" ? -Number(card.dataset.link) : Number(card.dataset[key]));
      cards.sort((a, b) => size(b) - size(a));
      for (const card of cards)
        card.hidden = (link.value && card.dataset.link !== link.value) || (outcome.value && card.dataset.outcome !== outcome.value);
      box.append(...cards);
    }
  };
  for (const choice of [sort, link, outcome]) choice.addEventListener("change", arrange);

  // Zoom and move.
  for (const scene of all(".scene")) {
    const whole = scene.viewBox.baseVal;
    const start = { x: -0.5, y: -0.5, width: Number(scene.dataset.width), height: Number(scene.dataset.height) };
    const view = { x: whole.x, y: whole.y, width: whole.width, height: whole.height };
    const show = () => scene.setAttribute("viewBox", `${view.x} ${view.y} ${view.width} ${view.height}`);
    const zoom = (factor, x, y) => {
      const width = Math.min(start.width, Math.max(start.width / 40, view.width / factor));
      const ratio = width / view.width;
      view.x = x - (x - view.x) * ratio;
      view.y = y - (y - view.y) * ratio;
      view.width = width;
      view.height *= ratio;
      keep();
    };
    const keep = () => {
      view.x = Math.min(start.x + start.width - view.width, Math.max(start.x, view.x));
      view.y = Math.min(start.y + start.height - view.height, Math.max(start.y, view.y));
      show();
    };
    const place = (event) => {
      const box = scene.getBoundingClientRect();
      return [view.x + ((event.clientX - box.left) / box.width) * view.width, view.y + ((event.clientY - box.top) / box.height) * view.height];
    };
    scene.addEventListener("wheel", (event) => {
      event.preventDefault();
      zoom(event.deltaY < 0 ? 1.25 : 0.8, ...place(event));
    }, { passive: false });
    let held = null;
    scene.addEventListener("pointerdown", (event) => (held = event));
    scene.addEventListener("pointermove", (event) => {
      if (!held || !event.buttons) return;
      const box = scene.getBoundingClientRect();
      view.x -= ((event.clientX - held.clientX) / box.width) * view.width;
      view.y -= ((event.clientY - held.clientY) / box.height) * view.height;
      held = event;
      keep();
    });
    for (const name of ["pointerup", "pointerleave"]) scene.addEventListener(name, () => (held = null));
    scene.addEventListener("dblclick", () => {
      Object.assign(view, start);
      show();
    });
    for (const button of all("[data-zoom]", scene.closest(".view")))
      button.addEventListener("click", () => {
        if (button.dataset.zoom === "all") Object.assign(view, start);
        else zoom(button.dataset.zoom === "in" ? 1.5 : 1 / 1.5, view.x + view.width / 2, view.y + view.height / 2);
        show();
      });
  }

  // The worst one to begin with: the sampler that pulls most.
  const first = document.querySelector(".cards .card");
  if (first) choose(first.id);
})();
