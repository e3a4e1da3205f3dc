"use strict";
(() => {
  const tiles = [...document.querySelectorAll("figure")];
  const large = document.getElementById("large");
  const stage = document.getElementById("stage");
  const nav = document.querySelector("nav");
  const home = nav.nextElementSibling;
  let present = 0;

  // The larger view borrows the tile's drawing and the page's switches, which then act on both.
  const show = (index) => {
    present = (index + tiles.length) % tiles.length;
    const picture = document.createElement("div");
    picture.className = "picture";
    const words = document.createElement("p");
    words.className = "facts";
    words.textContent = tiles[present].querySelector("figcaption").firstChild.textContent;
    picture.append(tiles[present].querySelector("svg").cloneNode(true), words);
    const tables = tiles[present].querySelector(".tables").cloneNode(true);
    tables.hidden = false;
    stage.replaceChildren(picture, tables);
    if (!large.open) {
      large.prepend(nav);
      large.showModal();
    }
  };

  tiles.forEach((tile, index) => {
    tile.addEventListener("click", () => show(index));
    tile.addEventListener("keydown", (event) => {
      if (event.key === "Enter") show(index);
    });
  });
  document.getElementById("close").addEventListener("click", () => large.close());
  large.addEventListener("click", (event) => {
    if (event.target === large) large.close();
  });
  large.addEventListener("close", () => {
    home.before(nav);
    tiles[present].focus();
  });
  large.addEventListener("keydown", (event) => {
    if (event.target.type === "radio" || !["ArrowLeft", "ArrowRight"].includes(event.key)) return;
    event.preventDefault();
    show(present + (event.key === "ArrowRight" ? 1 : -1));
  });
})();
