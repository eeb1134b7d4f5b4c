// Sorts and filters the table of results.
const filters = document.getElementById("filters");
const body = document.querySelector("#results tbody");
const heads = [...document.querySelectorAll("#results th[data-key]")];
const rows = [...body.rows];
filters.hidden = false;

function filter() {
  const asked = Object.fromEntries(new FormData(filters));
  const words = asked.material.toLowerCase();
  let shown = 0;
  for (const row of rows) {
    const d = row.dataset;
    const kept = d.material.toLowerCase().includes(words)
      && ["group", "model", "status"].every((key) => !asked[key] || d[key] === asked[key])
      && (!asked.least || Number(d.rmse) >= Number(asked.least)) && (!asked.slow || Number(d.seconds) >= Number(asked.slow));
    row.hidden = !kept;
    shown += kept;
  }
  document.getElementById("shown").textContent = `${shown} of ${rows.length} shown`;
}

function sort(head) {
  const { key, kind } = head.dataset;
  const up = head.getAttribute("aria-sort") !== "ascending";
  for (const other of heads) other.removeAttribute("aria-sort");
  head.setAttribute("aria-sort", up ? "ascending" : "descending");
  const of = (row) => row.dataset[key];
  rows.sort((a, b) => {
    if ((of(a) === "") !== (of(b) === "")) return of(a) === "" ? 1 : -1; // what has no value comes last
    const order = kind === "number" ? of(a) - of(b) : of(a).localeCompare(of(b), "en", { numeric: true });
    return up ? order : -order;
  });
  body.append(...rows);
}

filters.addEventListener("input", filter);
filters.addEventListener("reset", () => setTimeout(filter));
filters.addEventListener("submit", (event) => event.preventDefault());
for (const head of heads) head.firstElementChild.addEventListener("click", () => sort(head));
filter();
