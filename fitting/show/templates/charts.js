// Makes every chart of the page interactive; without this file they stay as they are drawn.
addEventListener("load", () => {
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const draw = async () => {
    for (const spec of document.querySelectorAll("script.spec")) {
      const place = document.getElementById(spec.dataset.for);
      const options = { actions: { export: true, source: false, compiled: false, editor: false }, renderer: "svg",
                        theme: dark.matches ? "dark" : undefined, config: { background: null } };
      place.removeAttribute("role");
      await window.vegaEmbed(place, JSON.parse(spec.textContent), options);
    }
    document.documentElement.dataset.charts = "drawn";
  };
  draw();
  dark.addEventListener("change", draw);
});
