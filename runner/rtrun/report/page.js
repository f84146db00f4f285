// The picture of all scenarios: a row each, as many as the filter leaves.
const overview = document.querySelector("#overview"), filter = document.querySelector("#filter");
const all = JSON.parse(document.querySelector("#overview-data").textContent);
let overviewSeen = false;
const MARKS = { min: "line-ns", median: "circle", p99: "diamond-open", "p99.99": "square-open", max: "line-ns" };

// Text that plotly shows as it is: it obeys some HTML.
function plain(text) {
  return text.replaceAll("&", "&amp;").replaceAll("<", "&lt;").replaceAll(">", "&gt;");
}

// A label in lines of at most so many characters, broken at spaces, or within a word that is longer.
function inLines(text, most) {
  const lines = [""];
  for (const word of text.split(" ").flatMap((word) => word.match(new RegExp(`.{1,${most}}`, "gu")) || [])) {
    if (lines.at(-1) && lines.at(-1).length + word.length >= most) lines.push("");
    lines.push(`${lines.pop()} ${word}`.trim());
  }
  return lines;
}

function drawOverview() {
  const rows = all.rows.filter((row) => !document.getElementById(row.id).hidden);
  const beside = wide.matches && !root.classList.contains("paper");
  overview.hidden = rows.length === 0;
  if (!rows.length) return;
  const limits = rows.flatMap((row) => row.deadline_us ?? []);
  const positive = rows.flatMap((row) => Object.values(row.us)).filter((value) => value > 0).concat(limits);
  const low = Math.min(...positive) / 1.5, high = Math.max(...positive) * 1.5;
  const at = (value) => value === null ? null : Math.max(value, low);
  const tone = (row) => colour(`--${row.style}`), place = rows.map((_, k) => k), traces = [];
  const mixed = { color: colour("--soft") };
  for (const answer of new Set(rows.map((row) => row.answer))) {
    const own = rows.map((row, k) => [row, k]).filter(([row]) => row.answer === answer);
    traces.push({ type: "scatter", mode: "lines", name: answer, hoverinfo: "skip", connectgaps: false,
      line: { color: tone(own[0][0]), width: 3 },
      x: own.flatMap(([row]) => [at(row.us.min), at(row.us.max), null]), y: own.flatMap(([, k]) => [k, k, null]) });
  }
  for (const [name, symbol] of Object.entries(MARKS)) {
    const below = (row) => row.us[name] !== null && row.us[name] < low;
    traces.push({ type: "scatter", mode: "markers", name, showlegend: false, x: rows.map((row) => at(row.us[name])), y: place,
      text: rows.map((row) => `${plain(row.label)}<br>${name} ${row.us[name]} us`), hovertemplate: "%{text}<extra></extra>",
      customdata: rows.map((row) => row.id),
      marker: { color: rows.map(tone), size: name === "max" || name === "min" ? 13 : 9, line: { color: rows.map(tone), width: 2 },
        symbol: rows.map((row) => below(row) ? "triangle-left" : symbol) } });
    traces.push({ type: "scatter", mode: "markers", name, x: [null], y: [null], marker: { ...mixed, symbol, size: 9, line: { ...mixed, width: 2 } } });
  }
  const limit = new Set(limits).size === 1 ? `deadline ${limits[0]} us` : "deadline";
  if (limits.length) traces.push({ type: "scatter", mode: "lines", name: limit, x: rows.flatMap((row) => [row.deadline_us, row.deadline_us, null]),
    y: place.flatMap((k) => [k - 0.6, k + 0.6, null]), line: { color: colour("--ink"), dash: "dash", width: 1.5 }, hovertemplate: "deadline %{x} us<extra></extra>" });
  const most = beside ? 60 : Math.max(20, Math.floor((overview.clientWidth - 20) / 7.2));
  const labels = rows.map((row) => inLines(`${row.mark} ${row.label}`, most));
  const tallest = 15 * Math.max(...labels.map((lines) => lines.length));
  // In a picture longer than a screen the axis and the legend are seen at once only where they stand above it.
  const above = rows.length > 25, keys = 84, end = beside ? 10 : 24;
  const pitch = (beside ? 9 : 25) + tallest, top = above ? keys + end : end, bottom = above ? 10 : keys;
  const layout = framed({ xaxis: { type: "log", range: [Math.log10(low), Math.log10(high)], title: { text: "us" }, side: above ? "top" : "bottom", minorloglabels: "none", dtick: 1 },
    yaxis: { range: [rows.length - 0.4, -0.6], showgrid: false, zeroline: false, showticklabels: false, fixedrange: false, automargin: false } });
  const link = (row, k) => `<a href="#${row.id}" target="_self">${labels[k].map(plain).join("<br>")}</a>`;
  const widest = beside ? 20 + 7.2 * Math.max(...labels.flat().map((line) => line.length)) : 10;
  Object.assign(layout, { height: top + bottom + pitch * rows.length, margin: { l: widest, r: 15, t: top, b: bottom },
    legend: { orientation: "h", y: above ? 1 : 0, yref: "container", yanchor: above ? "top" : "bottom", x: 0, xref: "container" },
    annotations: rows.map((row, k) => ({ xref: "paper", x: 0, y: k, text: link(row, k), showarrow: false, xshift: beside ? -8 : 0, align: beside ? "right" : "left",
      bgcolor: colour("--page"),
      yshift: beside ? 0 : 7.5 + tallest / 2, xanchor: beside ? "right" : "left", font: { color: tone(row), size: 12.5 } })) });
  if (root.classList.contains("paper")) layout.width = PAPER.overview;
  const drawing = overview.firstElementChild;
  drawing.style.height = `${layout.height}px`;
  if (!overviewSeen) return;
  plotly().react(drawing, traces, layout, config);
  if (!drawing.dataset.linked) {
    drawing.dataset.linked = "yes";
    drawing.on("plotly_click", ({ points: [point] }) => { if (point.customdata) location.hash = point.customdata; });
  }
}

function applyFilter() {
  const wanted = filter ? [...new FormData(filter)].filter(([, value]) => value) : [];
  let count = 0;
  for (const card of document.querySelectorAll("details[data-suite]")) {
    card.hidden = !wanted.every(([key, value]) => card.dataset[key] === value);
    count += !card.hidden;
  }
  if (filter) document.querySelector("#shown").textContent = `${count} scenarios`;
  drawOverview();
}

function openTarget() {
  const target = document.getElementById(decodeURIComponent(location.hash.slice(1)));
  if (target && target.tagName === "DETAILS") { target.open = true; target.scrollIntoView(); }
}

function redraw() {
  drawOverview();
  for (const figure of document.querySelectorAll(".plots figure"))
    if (figure.querySelector(".js-plotly-plot")) draw(figure);
}

if (filter) filter.addEventListener("change", applyFilter);
addEventListener("hashchange", openTarget);
// The hash stays where it is when the same link is followed again.
document.addEventListener("click", (event) => { if (event.target.closest && event.target.closest("a")) setTimeout(openTarget); });
wide.addEventListener("change", drawOverview);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
addEventListener("beforeprint", () => {
  root.classList.add("paper");
  overviewSeen = true;
  for (const figure of document.querySelectorAll("details[open] .plots figure")) draw(figure);
  drawOverview();
});
addEventListener("afterprint", () => {
  root.classList.remove("paper");
  // A plot that was given a width keeps it until it is made anew.
  for (const place of document.querySelectorAll(".js-plotly-plot")) plotly().purge(place);
  delete overview.firstElementChild.dataset.linked;
  redraw();
});
new IntersectionObserver((entries, observer) => {
  if (!entries.some((entry) => entry.isIntersecting)) return;
  observer.disconnect();
  overviewSeen = true;
  drawOverview();
}).observe(overview);
applyFilter();
openTarget();
