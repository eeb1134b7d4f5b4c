// Shows the pages of the two results that are chosen, and keeps the choice in the address.
const sides = ["left", "right"].map((side) => document.getElementById(side));
const asked = new URLSearchParams(location.search);
sides.forEach((choice, k) => {
  choice.selectedIndex = Math.min(k, choice.options.length - 1);
  const name = asked.get(choice.id);
  if ([...choice.options].some((option) => option.value === name)) choice.value = name;
  const show = () => {
    document.getElementById(`${choice.id}-page`).src = choice.selectedOptions[0].dataset.page;
    const address = new URLSearchParams(sides.map((each) => [each.id, each.value]));
    try { history.replaceState(null, "", `?${address}`); } catch { /* a browser may refuse it for a file */ }
  };
  choice.addEventListener("change", show);
  show();
});
