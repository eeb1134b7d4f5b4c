// Shows the pages of the two results that are chosen, and keeps the choice in the address.
const sides = ["left", "right"].map((side) => document.getElementById(side));
const numbers = JSON.parse(document.getElementById("all-numbers").textContent);
const table = document.getElementById("numbers");
const asked = new URLSearchParams(location.search);
function compare() {
  const pair = sides.map((choice) => numbers[choice.value]);
  const lines = ["words", "errors", "parameters"].flatMap((part) =>
    [...new Set(pair.flatMap((each) => Object.keys(each[part])))].map((key) => [part, key, pair.map((each) => each[part][key])]));
  table.tBodies[0].replaceChildren(...lines.map(([part, key, values]) => {
    const row = document.createElement("tr");
    const head = document.createElement("th");
    head.scope = "row";
    head.textContent = key;
    const known = values.every((x) => typeof x === "number");
    const cells = values.map((x, k) => {
      const cell = document.createElement("td");
      cell.className = part === "words" ? "" : "n";
      const text = typeof x === "number" ? Number(x.toPrecision(4)).toString() : x ?? "-";
      const kind = part === "errors" && known && x < values[1 - k] ? "strong" : "span";
      cell.append(Object.assign(document.createElement(kind), { textContent: text }));
      return cell;
    });
    row.append(head, ...cells);
    return row;
  }));
  table.hidden = false;
  for (const picture of document.querySelectorAll("#both img")) {
    const choice = document.getElementById(picture.dataset.side);
    picture.src = `pictures/${encodeURIComponent(choice.value)}.${picture.dataset.light}-fit.webp`;
  }
  for (const each of document.querySelectorAll("#both .wipe")) each.querySelectorAll("b").forEach((word, k) => (word.textContent = sides[k].value));
  document.getElementById("both").hidden = !pair.every((each) => each.words.model);
}

sides.forEach((choice, k) => {
  choice.selectedIndex = Math.min(k, choice.options.length - 1);
  const name = asked.get(choice.id);
  if ([...choice.options].some((option) => option.value === name)) choice.value = name;
  const show = () => {
    document.getElementById(`${choice.id}-page`).src = choice.selectedOptions[0].dataset.page;
    const address = new URLSearchParams(sides.map((each) => [each.id, each.value]));
    compare();
    try { history.replaceState(null, "", `?${address}`); } catch { /* a browser may refuse it for a file */ }
  };
  choice.addEventListener("change", show);
  show();
});
