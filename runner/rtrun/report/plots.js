"use strict";
// The pictures are there without this. It shows what lies under the pointer, and saves the data behind a plot as CSV.
const root = document.documentElement;
root.classList.add("scripted");
const UNITS = [[1e9, "s"], [1e6, "ms"], [1e3, "us"], [1, "ns"]];

// A time in the unit that suits it, as everywhere on the page.
function time(ns) {
  if (!ns) return "0 us";
  const size = Math.abs(ns) * (1 + 5e-5), [divisor, unit] = UNITS.find(([least]) => size >= least) ?? UNITS.at(-1);
  const text = (ns / divisor).toFixed(Math.min(3, Math.max(0, 3 - Math.floor(Math.log10(size / divisor)))));
  return `${Number(text) === ns / divisor ? Number(text) : text} ${unit}`;
}

function inUnit(value, { unit }) {
  if (unit === "ns") return time(value);
  if (unit === "date") return new Date(1000 * value).toISOString().slice(0, 16).replace("T", " ");
  return unit === "share" ? String(Number(value.toPrecision(3))) : String(Math.round(value)).replace(/\B(?=(\d{3})+$)/g, " ");
}

const data = (figure) => figure.data ??= JSON.parse(figure.querySelector("script").textContent);
const between = (edges, k, axis) => `${inUnit(edges[k], axis)} to ${inUnit(edges[k + 1], axis)}`;

function underCell({ x, y, cells }, across, up) {
  const column = Math.min(cells.counts[0].length - 1, Math.floor(across * cells.counts[0].length));
  const row = cells.places.findIndex((place, k) => place <= up && up < (cells.places[k + 1] ?? 2));
  const counts = cells.counts[Math.min(Math.max(row, 0), cells.counts.length - 1)];
  const along = x.unit === "count" && cells.x[1] - cells.x[0] === 1 ? inUnit(cells.x[column] + 0.5, x) : between(cells.x, column, x);
  return `${counts[column]} of ${between(cells.y, Math.min(Math.max(row, 0), cells.counts.length - 1), y)}, ${x.title} ${along}`;
}

// The point of all lines that is nearest: a path's points follow one another as those of the data do.
function underLine(figure, { x, y, marks }, across, up, box) {
  let best = { distance: Infinity };
  marks.forEach((mark, k) => {
    const path = figure.querySelectorAll("path:not(.grid)")[k], numbers = path.getAttribute("d").match(/-?[\d.]+(?:e-?\d+)?/g) ?? [];
    const dots = path.classList.contains("dots") ? 3 : 2;
    mark.x.forEach((value, point) => {
      const dx = (numbers[dots * point] / 1000 - across) * box.width, dy = (1 - numbers[dots * point + 1] / 1000 - up) * box.height;
      if (Math.hypot(dx, dy / 3) < best.distance) best = { distance: Math.hypot(dx, dy / 3), mark, point };
    });
  });
  const { mark, point } = best;
  if (!mark) return "";
  const value = mark.low ? `${inUnit(mark.low[point], y)} to ${inUnit(mark.y[point], y)}` : inUnit(mark.y[point], y);
  return `${mark.name}: ${y.title} ${value}, ${x.title} ${inUnit(mark.x[point], x)}`;
}

function point(event) {
  const frame = event.target.closest?.(".frame");
  for (const tip of document.querySelectorAll(".tip:not([hidden])")) if (tip.parentNode !== frame) tip.hidden = true;
  if (!frame) return;
  const figure = frame.closest("figure"), tip = frame.querySelector(".tip"), box = frame.getBoundingClientRect();
  const across = (event.clientX - box.left) / box.width, up = 1 - (event.clientY - box.top) / box.height, plot = data(figure);
  tip.textContent = plot.cells ? underCell(plot, across, up) : underLine(figure, plot, across, up, box);
  tip.hidden = !tip.textContent;
  tip.style.left = across < 0.5 ? `calc(${100 * across}% + 12px)` : "";
  tip.style.right = across < 0.5 ? "" : `calc(${100 * (1 - across)}% + 12px)`;
  tip.style.top = `${Math.min(80, 100 * (1 - up))}%`;
}

// What a spreadsheet would take for a formula has an apostrophe before it.
const quoted = (text) => `"${(/^[=+\-@\t\r]/.test(text) ? "'" : "") + text.replaceAll('"', '""')}"`;
const named = ({ title, unit }) => quoted(unit === "ns" ? `${title} in ns` : title);

function asCsv({ x, y, marks, cells }) {
  if (cells) return [`${named(x)} from,${named(x)} to,${named(y)} from,${named(y)} to,count`, ...cells.counts.flatMap((row, r) => row.flatMap((count, c) =>
    count ? [[cells.x[c], cells.x[c + 1], cells.y[r], cells.y[r + 1], count].join()] : []))].join("\n") + "\n";
  const lines = marks.flatMap((mark) => mark.x.map((value, k) => [quoted(mark.name), value, mark.y[k], ...(mark.low ? [mark.low[k]] : [])].join()));
  return [`"line",${named(x)},${named(y)}${marks.some((mark) => mark.low) ? ",lowest" : ""}`, ...lines].join("\n") + "\n";
}

function save(figure) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([asCsv(data(figure))], { type: "text/csv" }));
  link.download = `${figure.id}.csv`;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

addEventListener("pointermove", point);
addEventListener("pointerdown", point);
addEventListener("click", ({ target }) => { if (target.matches?.("button.csv")) save(target.closest("figure")); });
