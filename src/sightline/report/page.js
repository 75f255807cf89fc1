"use strict";
// Values under the pointer, read off the drawing: of the nearest point of a curve, or of the cell of a map.
const tip = document.body.appendChild(document.createElement("div"));
tip.id = "tip";
tip.setAttribute("aria-hidden", "true");
const known = new WeakMap();
const short = value => String(Number(value.toPrecision(4))).replace("-", "−");
const numbers = text => (text || "").split(" ").map(Number);

function pointsOf(path) {
  if (known.has(path)) return known.get(path);
  const found = [], line = path.classList.contains("l");
  for (const [, letter, body] of path.getAttribute("d").matchAll(/([A-Za-z])([^A-Za-z]*)/g)) {
    if (letter !== "M" && !(letter === "l" && line)) continue;
    const steps = body.match(/-?\d+/g).map(Number);
    let [x, y] = letter === "M" ? [0, 0] : found[found.length - 1];
    for (let k = 0; k < steps.length; k += 2) found.push([x += steps[k], y += steps[k + 1]]);
  }
  known.set(path, found);
  return found;
}

function valueAt(share, axis) {
  let [low, high, log, back] = numbers(axis);
  if (back) share = 1 - share;
  return log ? low * (high / low) ** share : low + (high - low) * share;
}

function pixelsOf(image) {
  if (known.has(image)) return known.get(image);
  known.set(image, null);
  const copy = new Image();
  copy.onload = () => {
    const canvas = document.createElement("canvas");
    [canvas.width, canvas.height] = [copy.naturalWidth, copy.naturalHeight];
    const brush = canvas.getContext("2d");
    brush.drawImage(copy, 0, 0);
    known.set(image, brush.getImageData(0, 0, canvas.width, canvas.height));
  };
  copy.src = image.getAttribute("href");
  return null;
}

function cellAt(image, x, y) {
  const pixels = pixelsOf(image), [left, top, width, height] = ["x", "y", "width", "height"].map(a => image.getAttribute(a) / 10);
  const column = Math.floor((x - left) / width * pixels?.width), row = Math.floor((y - top) / height * pixels?.height);
  if (!pixels || column < 0 || row < 0 || column >= pixels.width || row >= pixels.height) return null;
  const own = pixels.data.slice(4 * (row * pixels.width + column), 4 * (row * pixels.width + column) + 4);
  if (!own[3]) return null;
  const stops = image.dataset.stops.split(" ").map(c => [1, 3, 5].map(k => parseInt(c.slice(k, k + 2), 16)));
  const names = image.dataset.names?.split("\n"), steps = names ? stops.length : 255;
  let best = 0, least = Infinity;
  for (let k = 0; k < steps; k++) {
    const place = k / (steps - 1 || 1) * (stops.length - 1), n = Math.min(Math.floor(place), stops.length - 2), part = place - n;
    const colour = names ? stops[k] : stops[n].map((v, c) => v + part * (stops[n + 1][c] - v));
    const far = colour.reduce((sum, v, c) => sum + (v - own[c]) ** 2, 0);
    if (far < least) [least, best] = [far, k];
  }
  if (names) return names[best];
  return `${image.dataset.bar}: ${short(valueAt(best / (steps - 1), image.dataset.range))}`;
}

function saidAt(svg, event) {
  const matrix = svg.getScreenCTM();
  if (!matrix) return null;
  const { x, y } = new DOMPoint(event.clientX, event.clientY).matrixTransform(matrix.inverse());
  for (const panel of svg.querySelectorAll("g.panel")) {
    const [left, top, width, height] = numbers(panel.dataset.box);
    if (x < left - 4 || y < top - 4 || x > left + width + 4 || y > top + height + 4) continue;
    let nearest = null, least = 18;
    for (const path of panel.querySelectorAll("path[data-n]")) {
      pointsOf(path).forEach(([px, py], k) => {
        const far = Math.hypot(px / 10 - x, py / 10 - y);
        if (far < least) [least, nearest] = [far, { path, k, x: px / 10, y: py / 10 }];
      });
    }
    const place = nearest || { x, y };
    const axes = [[panel.dataset.xt, panel.dataset.x, (place.x - left) / width], [panel.dataset.yt, panel.dataset.y, 1 - (place.y - top) / height]]
      .filter(([title]) => title).map(([title, axis, share]) => `${title}: ${short(valueAt(share, axis))}`);
    if (nearest) {
      const own = nearest.path.dataset.s?.split("\n")[nearest.k];
      return [nearest.path.dataset.n, ...(own ? [own] : []), ...axes];
    }
    const image = panel.querySelector("image[data-stops]"), cell = image && cellAt(image, x, y);
    return cell ? [cell, ...axes] : null;
  }
  return null;
}

document.addEventListener("pointermove", event => {
  const svg = event.target.closest?.("svg.drawn"), said = svg && saidAt(svg, event);
  tip.style.display = said ? "block" : "none";
  if (!said) return;
  tip.textContent = said.join("\n");
  tip.style.left = `${Math.max(4, Math.min(event.clientX + 14, innerWidth - tip.offsetWidth - 8))}px`;
  tip.style.top = `${event.clientY + 16 + tip.offsetHeight > innerHeight ? event.clientY - tip.offsetHeight - 10 : event.clientY + 16}px`;
});
// The handle between two pictures of the same ground.
for (const handle of document.querySelectorAll(".slider input"))
  handle.addEventListener("input", () => handle.parentNode.style.setProperty("--cut", `${handle.value}%`));

// What is wider than the page says that it goes on to the right, until its end is seen.
for (const box of document.querySelectorAll(".scroll")) {
  const hint = document.createElement("p");
  [hint.className, hint.textContent, hint.hidden] = ["more", "scroll sideways for the rest →", true];
  hint.setAttribute("aria-hidden", "true");
  box.before(hint);
  const look = () => {
    const rest = box.scrollWidth - box.clientWidth, ends = box.scrollLeft >= rest - 2;
    hint.hidden = rest <= 2;
    for (const one of [hint, box]) one.classList.toggle("ends", ends);
    box.classList.toggle("cut", rest > 2);
  };
  box.addEventListener("scroll", look);
  new ResizeObserver(look).observe(box);
}
