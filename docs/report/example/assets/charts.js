// Makes every chart of the page interactive and as wide as its place; without this file they stay as they are drawn.
const NARROW = 640; // pixels: up to which charts that lie side by side lie one over the other
const AXIS = 75; // pixels beside a plot: of words, numbers and padding

function widened(spec, room) {
  if (spec.hconcat && room < NARROW) {
    spec.vconcat = spec.hconcat;
    delete spec.hconcat;
  }
  const across = spec.hconcat?.length ?? 1;
  for (const part of spec.hconcat ?? spec.vconcat ?? [spec]) part.width = Math.floor(room / across) - AXIS;
  spec.config.legend.columns = Math.max(2, Math.floor(room / across / 110));
  return spec;
}

addEventListener("load", () => {
  let room = 0;
  const draw = async () => {
    if (room === innerWidth) return;
    room = innerWidth;
    for (const spec of document.querySelectorAll("script.spec")) {
      const place = document.getElementById(spec.dataset.for);
      const options = { actions: { export: true, source: false, compiled: false, editor: false }, renderer: "svg" };
      place.removeAttribute("role");
      await window.vegaEmbed(place, widened(JSON.parse(spec.textContent), place.clientWidth), options);
    }
    document.documentElement.dataset.charts = "drawn";
  };
  draw();
  let waiting;
  addEventListener("resize", () => {
    clearTimeout(waiting);
    waiting = setTimeout(draw, 200);
  });
});
