"use strict";
// Plots are drawn by plotly when they come into view, and again when the colours of the page change. Plotly itself is run
// for the first of them, after the browser has shown answer and tables.
const root = document.documentElement;
const wide = matchMedia("(min-width: 800px)");
const PAPER = { overview: 680, width: 335, height: 290 };  // px: two plots side by side on a page of letter or A4 size
const config = { responsive: true, displayModeBar: false };
root.classList.add("scripted");

function plotly() {
  if (!window.Plotly) {
    const script = document.createElement("script");
    script.textContent = document.querySelector("#plotly").textContent;
    document.head.append(script);
  }
  return window.Plotly;
}

function colour(name) {
  return name.startsWith("--") ? getComputedStyle(root).getPropertyValue(name).trim() : name;
}

// A colour in a figure is the name of a CSS variable, or a list of them.
function parsed(text) {
  return JSON.parse(text, (key, value) =>
    key !== "color" ? value : Array.isArray(value) ? value.map(colour) : colour(value));
}

function framed(layout) {
  const axis = { gridcolor: colour("--rule"), zerolinecolor: colour("--rule"), linecolor: colour("--soft"),
    automargin: true, exponentformat: "none", separatethousands: true };
  const flat = { paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", separators: ". ",
    font: { color: colour("--ink"), family: "system-ui, sans-serif", size: 12 },
    hoverlabel: { align: "left", namelength: -1 }, margin: { l: 50, r: 15, t: 10, b: 45 }, hovermode: "closest",
    legend: { orientation: "h", y: 1.02, yanchor: "bottom", x: 0 }, showlegend: true };
  for (const name of ["xaxis", "yaxis"]) flat[name] = { ...axis, ...layout[name] };
  if (layout.scene) {
    flat.scene = { ...layout.scene };
    for (const name of ["xaxis", "yaxis", "zaxis"])
      flat.scene[name] = { gridcolor: colour("--rule"), ...layout.scene[name] };
  }
  return { ...layout, ...flat };
}

function canTurn() {
  return !root.classList.contains("paper") && !!document.createElement("canvas").getContext("webgl");
}

function draw(figure) {
  const place = figure.querySelector(".plot"), { data, layout } = parsed(figure.querySelector("script").textContent);
  const shown = framed(layout);
  if (layout.height) place.style.height = `${layout.height}px`;
  if (layout.scene) {
    if (canTurn()) { delete shown.xaxis; delete shown.yaxis; shown.margin = { l: 0, r: 0, t: 0, b: 0 }; }
    else { delete shown.scene; data[0].type = "heatmap"; }
    shown.showlegend = false;
    plotly().purge(place);
  }
  if (root.classList.contains("paper")) Object.assign(shown, { width: PAPER.width, height: PAPER.height });
  plotly().react(place, data, shown, config);
}

// A browser keeps few 3-D pictures at a time: what is out of view gives its picture back.
function drawInView({ target, isIntersecting }) {
  const place = target.querySelector(".plot"), drawn = place.classList.contains("js-plotly-plot");
  if (isIntersecting && !drawn) draw(target);
  else if (!isIntersecting && drawn && place.querySelector("canvas")) { plotly().purge(place); place.classList.remove("js-plotly-plot"); }
}
const watcher = new IntersectionObserver((entries) => entries.forEach(drawInView), { rootMargin: "200px" });
for (const figure of document.querySelectorAll(".plots figure")) watcher.observe(figure);
