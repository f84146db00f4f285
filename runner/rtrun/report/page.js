// The filter, links into what is closed, and paper, which has everything open.
const filter = document.querySelector("#filter"), title = document.title;

function applyFilter() {
  const wanted = [...new FormData(filter)].filter(([, value]) => value);
  let count = 0;
  for (const card of document.querySelectorAll("details[data-suite]")) {
    card.hidden = !wanted.every(([key, value]) => card.dataset[key] === value);
    count += !card.hidden;
    const row = document.querySelector(`#overview a[href="#${card.id}"]`);
    if (row) row.hidden = card.hidden;
  }
  document.querySelector("#shown").textContent = `${count} scenarios`;
}

// What a link leads to is opened, and the tab says which scenario it is.
function openTarget() {
  const target = document.getElementById(decodeURIComponent(location.hash.slice(1)));
  if (!target) return;
  for (let details = target.closest("details"); details; details = details.parentElement.closest("details")) details.open = true;
  const card = target.closest("details.card[data-suite]");
  document.title = card ? `${card.querySelector(".name").textContent} – ${title}` : title;
  target.scrollIntoView();
}

filter?.addEventListener("change", applyFilter);
addEventListener("hashchange", openTarget);
// The hash stays where it is when the same link is followed again.
addEventListener("click", ({ target }) => { if (target.closest?.("a[href^='#']")) setTimeout(openTarget); });
addEventListener("beforeprint", () => {
  root.classList.add("paper");
  for (const closed of document.querySelectorAll("details:not([open])")) { closed.open = true; closed.dataset.closed = ""; }
});
addEventListener("afterprint", () => {
  root.classList.remove("paper");
  for (const opened of document.querySelectorAll("details[data-closed]")) { opened.open = false; delete opened.dataset.closed; }
});
if (filter) applyFilter();
openTarget();
