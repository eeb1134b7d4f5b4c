// The live view, in a page and in notebooks: shows what it is told of results, asks for frames of what is edited.
// A panel waits for one answer before it asks again, and then asks for the newest only.

const REST_MS = 180 // after the last movement a fine frame is asked for
const STEPS = 1000 // of a slider
const DECADES = 6 // that a logarithmic scale reaches below the brightest
const APART = 6 // pixels between marks
const SLOW_MS = 400 // after which it is said that a frame is being computed
const SCALES = {
  "cube root": { to: Math.cbrt, back: (x) => x ** 3 },
  logarithmic: { to: Math.log10, back: (x) => 10 ** x },
  linear: { to: (x) => x, back: (x) => x },
}
const LIGHTS = ["lamp", "environment"]
const MARKS = [
  (x, y) => `M${x - 3} ${y}a3 3 0 1 0 6 0a3 3 0 1 0 -6 0`,
  (x, y) => `M${x - 2.6} ${y - 2.6}h5.2v5.2h-5.2z`,
  (x, y) => `M${x} ${y - 3.4}l3.2 5.6h-6.4z`,
  (x, y) => `M${x} ${y - 3.4}l3.4 3.4l-3.4 3.4l-3.4 -3.4z`,
]
let made = 0

function node(tag, attributes = {}, ...children) {
  const svg = ["svg", "g", "path", "line", "text", "circle", "rect", "clipPath", "defs", "tspan"].includes(tag)
  const found = svg ? document.createElementNS("http://www.w3.org/2000/svg", tag) : document.createElement(tag)
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) found.addEventListener(name.slice(2), value)
    else if (value === true) found.setAttribute(name, "")
    else if (value !== false && value != null) found.setAttribute(name, value)
  }
  found.append(...children.filter((x) => x != null))
  return found
}

const digits = (x, n = 4) => {
  if (x === 0) return "0"
  const size = Math.abs(x)
  return size >= 1e5 || size < 1e-4 ? x.toExponential(2).replace("e+", "e") : String(Number(x.toPrecision(n)))
}

/** A symbol such as β^coat or σ_s, raised and lowered. */
const letters = (symbol) => symbol.split(/(?=[_^])/).map((part) =>
  part.startsWith("_") ? node("sub", {}, part.slice(1)) : part.startsWith("^") ? node("sup", {}, part.slice(1).replace(/[()]/g, "")) : part)

/** Where a number is between the bounds of its parameter, from 0 to 1, in the parameter's own scale. */
const position = (q, value) => {
  const [x, low, high] = [value, q.lower, q.upper].map((y) => (q.log ? Math.log(Math.max(y - q.offset, 1e-12)) : y))
  return Math.min(1, Math.max(0, (x - low) / (high - low || 1)))
}
const between = (q, u) => {
  if (!q.log) return q.lower + (q.upper - q.lower) * u
  const low = Math.max(q.lower - q.offset, 1e-12)
  return Math.min(q.upper, Math.max(q.lower, q.offset + low * ((q.upper - q.offset) / low) ** u))
}

/** A slider of one number, with its interval on it. */
class Slider {
  constructor(q, place, changed) {
    Object.assign(this, { q, changed, value: q.value, id: `merlfit-${++made}` })
    const interval = q.interval ? `; 90 % interval ${digits(q.interval[0])} to ${digits(q.interval[1])} (${q.interval_of})` : ""
    const name = q.channel ? `${q.parameter}, channel ${q.channel}` : q.parameter
    this.range = node("input", {
      type: "range", min: 0, max: STEPS, step: "any", "aria-label": `${name}: ${q.meaning}${interval}`,
      oninput: () => this.set(between(q, this.range.value / STEPS), true),
      onchange: () => this.changed(false), onkeydown: (event) => this.key(event),
    })
    this.number = node("input", {
      type: "text", inputmode: "decimal", "aria-label": `${name}, number`, autocomplete: "off", spellcheck: "false",
      onchange: () => this.typed(),
    })
    this.reset = node("button", {
      type: "button", class: "quiet", title: `back to ${digits(q.value)}, ${place.before}`, "aria-label": `${name}: ${place.before}`,
      onclick: () => { this.set(q.value, false); this.range.focus() },
    }, "↺")
    const track = node("div", { class: "track", title: `${q.meaning}${interval}` })
    if (q.interval) {
      const [low, high] = q.interval.map((x) => position(q, x))
      track.append(node("i", { class: "interval", style: `--from:${low};--to:${high}` }))
    }
    track.append(node("i", { class: "as-fitted", style: `--from:${position(q, q.value)}` }), this.range)
    const tag = q.channel ? node("b", { class: "channel", style: `--channel:${place.colour}` }, q.channel) : null
    this.el = node("div", { class: "slider" }, tag, track, this.number, this.reset)
    this.show()
  }
  set(value, moving, quiet = false) {
    this.value = value
    this.show()
    if (!quiet) this.changed(moving, this)
  }
  typed() {
    const value = Number(this.number.value.replace(",", "."))
    const good = this.number.value.trim() !== "" && value >= this.q.lower && value <= this.q.upper
    good ? this.number.removeAttribute("aria-invalid") : this.number.setAttribute("aria-invalid", "true")
    this.number.title = good ? "" : `a number between ${digits(this.q.lower)} and ${digits(this.q.upper)}`
    if (good) this.set(value, false)
  }
  key(event) { // a native slider with step "any" would move by a tenth of it
    const step = { ArrowRight: 2, ArrowUp: 2, ArrowLeft: -2, ArrowDown: -2, PageUp: 50, PageDown: -50 }[event.key]
    if (step === undefined) return
    event.preventDefault()
    const fine = event.shiftKey ? 0.1 : 1
    this.set(between(this.q, Math.min(1, Math.max(0, position(this.q, this.value) + (fine * step) / STEPS))), true)
  }
  get edited() { return this.value !== this.q.value }
  show() {
    this.range.value = STEPS * position(this.q, this.value)
    this.range.setAttribute("aria-valuetext", `${digits(this.value)} ${this.q.unit}`.trim())
    if (document.activeElement !== this.number || !this.number.hasAttribute("aria-invalid")) this.number.value = digits(this.value)
    this.number.removeAttribute("aria-invalid")
    this.el.classList.toggle("edited", this.edited)
    this.reset.disabled = !this.edited
  }
}

/** Lobes in the plane of incidence, with a light that can be moved. */
class Lobes {
  constructor(result, common, turned) {
    Object.assign(this, { result, common, turned, size: [640, 330] })
    const clip = `merlfit-clip-${++made}`
    this.frame = node("g", { class: "axes" })
    this.clip = node("rect")
    const inner = node("g", { "clip-path": `url(#${clip})` })
    this.curves = result.channels.map((channel, c) => {
      const g = node("g", { style: `--channel:${channel.colour}` })
      const own = { band: node("path", { class: "band" }), before: node("path", { class: "before" }),
        file: node("path", { class: "file" }), fit: node("path", { class: "fit", "data-channel": channel.name }) }
      g.append(...Object.values(own))
      inner.append(g)
      return { ...own, mark: MARKS[c % MARKS.length] }
    })
    this.light = this.handle("light", -1)
    this.mirror = this.handle("mirror", 1)
    this.svg = node("svg", { role: "group", "aria-label": `Lobes of ${result.name} in the plane of incidence` },
      node("defs", {}, node("clipPath", { id: clip }, this.clip)), this.frame, inner, this.mirror, this.light)
    this.el = node("div", { class: "lobes" }, this.svg)
    new ResizeObserver(([entry]) => {
      const width = Math.max(240, Math.round(entry.contentRect.width))
      if (width !== this.size[0]) { this.size = [width, Math.round(Math.min(380, Math.max(230, 0.5 * width)))]; this.draw() }
    }).observe(this.el)
  }
  handle(name, side) {
    const words = { light: "light", mirror: "mirror direction" }[name]
    const found = node("g", { class: `handle ${name}` }, node("line", { class: "line" }), node("line", { class: "grip" }), node("circle", { r: 8 }), node("text", {}, words))
    if (side < 0) {
      const set = { tabindex: 0, role: "slider", "aria-label": "theta_i, the angle of the light", "aria-valuemin": 0, "aria-valuemax": this.common.steepest }
      for (const [key, value] of Object.entries(set)) found.setAttribute(key, value)
      found.addEventListener("keydown", (event) => {
        const step = { ArrowLeft: 1, ArrowUp: 1, ArrowRight: -1, ArrowDown: -1, PageUp: 10, PageDown: -10 }[event.key]
        if (step) { event.preventDefault(); this.turned(this.common.theta_i + step) }
      })
    }
    found.addEventListener("pointerdown", (event) => { found.setPointerCapture(event.pointerId); event.preventDefault(); if (side < 0) found.focus() })
    found.addEventListener("pointermove", (event) => {
      if (!found.hasPointerCapture(event.pointerId)) return
      const box = this.svg.getBoundingClientRect()
      this.turned(side * this.angle(event.clientX - box.left))
    })
    return found
  }
  get box() { return { left: 54, right: this.size[0] - 12, top: 26, bottom: this.size[1] - 38 } }
  x(angle) { return this.box.left + ((angle + 90) / 180) * (this.box.right - this.box.left) }
  angle(x) { return ((x - this.box.left) / (this.box.right - this.box.left)) * 180 - 90 }
  y(value) {
    const { top, bottom } = this.box
    if (value == null || (this.common.scale === "logarithmic" && value <= 0)) return null
    const [low, high] = this.range.map(SCALES[this.common.scale].to)
    return bottom - ((SCALES[this.common.scale].to(value) - low) / (high - low)) * (bottom - top)
  }
  show(lobe, moving) { this.lobe = lobe; this.moving = moving; this.draw() }
  draw() {
    if (!this.lobe) return
    const { lobe } = this, key = [lobe.theta_i, this.common.scale, ...this.size].join()
    if (!this.moving || this.drawn !== key) this.reach()
    const still = [key, ...this.range].join()
    if (this.still !== still || !this.moving) this.axes(still)
    this.drawn = key
    this.curves.forEach((own, c) => own.fit.setAttribute("d", this.path(lobe.angles, lobe.fit[c])))
  }
  reach() { // rests while something moves, so that a lobe is seen to grow
    const { lobe } = this, shown = [lobe.file, lobe.before, lobe.fit].filter(Boolean).flat(2).filter((x) => x > 0)
    const most = Math.max(1e-9, ...shown), least = Math.min(most, ...shown)
    this.range = this.common.scale === "logarithmic" ? [Math.max(least, most / 10 ** DECADES) / 2, most * 3]
      : [0, most * (this.common.scale === "linear" ? 1.1 : 1.25)]
  }
  axes(still) {
    this.still = still
    const { box, lobe } = this, [width, height] = this.size
    this.svg.setAttribute("viewBox", `0 0 ${width} ${height}`)
    this.svg.style.height = `${height}px`
    for (const [k, v] of Object.entries({ x: box.left, y: box.top, width: box.right - box.left, height: box.bottom - box.top })) this.clip.setAttribute(k, v)
    const parts = []
    for (const angle of [-90, -60, -30, 0, 30, 60, 90]) {
      const x = this.x(angle)
      parts.push(node("line", { x1: x, x2: x, y1: box.top, y2: box.bottom }), node("text", { x, y: box.bottom + 15, "text-anchor": "middle" }, `${angle}°`))
    }
    for (const value of this.ticks()) {
      const y = this.y(value)
      parts.push(node("line", { x1: box.left, x2: box.right, y1: y, y2: y }), node("text", { x: box.left - 6, y: y + 4, "text-anchor": "end" }, digits(value, 2)))
    }
    parts.push(node("text", { class: "name", x: (box.left + box.right) / 2, y: height - 4, "text-anchor": "middle" }, "angle of the viewer, θ", node("tspan", { dy: 3, "font-size": 9 }, "o")),
      node("text", { class: "name", x: 4, y: 13 }, `BRDF (1/sr), ${this.common.scale} scale`))
    this.frame.replaceChildren(...parts)
    this.curves.forEach((own, c) => {
      own.before.setAttribute("d", this.path(lobe.angles, lobe.before[c]))
      own.file.setAttribute("d", lobe.file ? this.marks(lobe.at, lobe.file[c], own.mark) : "")
      own.band.setAttribute("d", lobe.low ? this.area(lobe.angles, lobe.low[c], lobe.high[c]) : "")
    })
    for (const [handle, side] of [[this.light, -1], [this.mirror, 1]]) {
      const x = this.x(side * lobe.theta_i), [line, grip, circle, text] = handle.children
      for (const each of [line, grip]) for (const [k, v] of Object.entries({ x1: x, x2: x, y1: box.top, y2: box.bottom })) each.setAttribute(k, v)
      circle.setAttribute("cx", x); circle.setAttribute("cy", box.top)
      const inward = x + 110 > width
      text.setAttribute("x", x + (inward ? -12 : 12)); text.setAttribute("y", box.top + 4)
      text.setAttribute("text-anchor", inward ? "end" : "start")
      text.toggleAttribute("hidden", side > 0 && lobe.theta_i < 14)
    }
    this.light.setAttribute("aria-valuenow", lobe.theta_i)
    this.light.setAttribute("aria-valuetext", `${lobe.theta_i} degrees`)
  }
  ticks() {
    const [low, high] = this.range, found = []
    for (let k = Math.ceil(Math.log10(high)); k >= -7; k--) for (const m of this.common.scale === "logarithmic" ? [1] : [5, 2, 1]) {
      const value = m * 10 ** k, y = value >= low && value <= high ? this.y(value) : null
      if (y != null && y < this.box.bottom - 22 && y > this.box.top + 6 && found.every((x) => Math.abs(x.y - y) > 24)) found.push({ value, y })
    }
    const some = found.map((x) => x.value)
    return this.common.scale === "logarithmic" ? some : [...some, 0]
  }
  path(angles, values) {
    let d = "", pen = "M"
    values.forEach((value, k) => {
      const y = this.y(value)
      if (y == null) { pen = "M"; return }
      d += `${pen}${this.x(angles[k]).toFixed(1)} ${Math.max(-999, y).toFixed(1)}`
      pen = "L"
    })
    return d
  }
  area(angles, low, high) {
    const up = angles.map((a, k) => [this.x(a), this.y(high[k])]), down = angles.map((a, k) => [this.x(a), this.y(low[k])]).reverse()
    const all = [...up, ...down].filter(([, y]) => y != null)
    return all.length ? `M${all.map(([x, y]) => `${x.toFixed(1)} ${y.toFixed(1)}`).join("L")}Z` : ""
  }
  marks(angles, values, mark) {
    let d = "", last = null
    values.forEach((value, k) => {
      const x = this.x(angles[k]), y = this.y(value)
      if (y == null || y > this.box.bottom || (last && Math.hypot(x - last[0], y - last[1]) < APART)) return
      d += mark(Number(x.toFixed(1)), Number(y.toFixed(1)))
      last = [x, y]
    })
    return d
  }
}

/** One result: spheres, lobes, sliders, effects, and what is done with what was edited. */
class Panel {
  constructor(result, index, about, common, model) {
    Object.assign(this, { result, index, common, model, off: new Set(), busy: false, waiting: null })
    this.images = {}
    this.lobes = new Lobes(result, common, (theta_i) => common.turn(theta_i))
    this.said = node("p", { class: "said", role: "status" })
    this.pace = node("output", { class: "pace", "aria-live": "off", title: "From a movement to its frame" })
    const [parameters, sliders] = this.parameters()
    this.sliders = sliders
    this.el = node("section", { class: "panel", "aria-label": `${result.name}, ${result.model}` },
      node("div", { class: "inside" }, node("header", {}, node("h2", {}, result.name), node("p", {}, node("b", {}, result.model), ` · ${result.data}`),
        node("p", { class: "fine" }, result.error, this.badge = node("span", { class: "badge", hidden: true }, "edited"))),
      node("div", { class: "look" }, this.spheres(), this.legend(), this.lobes.el),
      node("div", { class: "edit" }, parameters, this.effects(), this.keep(about))))
  }
  spheres() {
    const shown = this.result.file ? ["fit"] : ["file", "fit"]
    const figures = LIGHTS.flatMap((light) => shown.map((what) => {
      const image = node("img", { alt: `Sphere of the ${what} under the ${light}`, width: 256, height: 256, draggable: "false" })
      this.images[`${what} ${light}`] = image
      const apart = what === "fit" && !this.result.file ? (this.images[`apart ${light}`] = node("span", { class: "apart", title: "Mean CIELAB distance of the lit pixels from the file's; about 1 is just noticeable" })) : null
      return node("figure", {}, image, node("figcaption", {}, node("b", {}, what), ` ${what === "file" && this.result.scattered ? "between its samples, " : ""}${light}`, apart))
    }))
    return node("div", { class: `spheres of-${shown.length}` }, ...figures)
  }
  legend() {
    const scattered = this.result.scattered ? "'s samples within 2° of the plane" : ""
    const items = [
      this.result.file ? null : node("span", { class: "key marks" }, `file${scattered}`), node("span", { class: "key line" }, "fit as it is now"),
      node("span", { class: "key thin" }, this.result.before), node("span", { class: "key shade" }, "posterior, 5 to 95 %"),
    ]
    const channels = this.result.channels.map((c) => node("b", { class: "channel", style: `--channel:${c.colour}` }, c.name))
    this.shade = items[3]
    const without = this.result.file ? node("p", { class: "fine" }, `Without the file: ${this.result.file}`) : null
    return node("div", { class: "legend" }, ...channels, ...items, this.pace, without)
  }
  parameters() {
    const groups = Map.groupBy ? Map.groupBy(this.result.parameters, (q) => q.parameter) : this.result.parameters.reduce((m, q) => m.set(q.parameter, [...(m.get(q.parameter) ?? []), q]), new Map())
    const sliders = [], el = node("div", { class: "parameters" })
    this.all = node("button", { type: "button", class: "quiet", disabled: true, onclick: () => { sliders.forEach((x) => x.set(x.q.value, false, true)); this.changed(false) } }, `↺ all ${this.result.before}`)
    const kinds = [...new Set(this.result.parameters.map((q) => q.interval_of).filter(Boolean))].join(", else ")
    el.append(node("p", { class: "legend" }, kinds ? node("span", { class: "key interval-key" }, `90 % interval (${kinds})`) : null, node("span", { class: "key tick" }, this.result.before), this.all))
    for (const [name, own] of groups) {
      const q = own[0], colour = (c) => this.result.channels.find((x) => x.name === c) ?? { colour: "#888" }
      const together = own.length > 1 ? node("input", { type: "checkbox" }) : null
      const mine = own.map((each) => new Slider(each, { ...colour(each.channel), before: this.result.before }, (moving, from) => {
        if (from && together?.checked) mine.filter((x) => x !== from).forEach((x) => x.follow(from))
        this.changed(moving)
      }))
      for (const each of mine) each.follow = (from) => {
        const u = position(each.q, each.q.value) + position(from.q, from.value) - position(from.q, from.q.value)
        each.set(between(each.q, Math.min(1, Math.max(0, u))), true, true)
      }
      sliders.push(...mine)
      const bounds = `${digits(q.lower)} to ${digits(q.upper)}${q.unit ? ` ${q.unit}` : ""}${q.log ? ", log" : ""}`
      el.append(node("fieldset", {},
        node("legend", {}, node("b", {}, ...letters(q.symbol)), node("code", {}, name), node("span", { class: "meaning", title: q.meaning }, q.meaning), node("span", { class: "bounds" }, bounds)),
        ...mine.map((x) => x.el), together ? node("label", { class: "together" }, together, "move together") : null))
    }
    if (this.result.fixed.length) el.append(node("p", { class: "fine" }, `Not free: ${this.result.fixed.join(", ")}`))
    return [el, sliders]
  }
  effects() {
    if (!this.result.effects.length) return null
    this.switches = this.result.effects.map((effect) => {
      const box = node("input", { type: "checkbox", role: "switch", checked: true, onchange: () => {
        box.checked ? this.off.delete(effect.name) : this.off.add(effect.name)
        this.ask(false)
      } })
      const cost = node("small", {}, effect.instead === "none" ? "" : `off: ${effect.instead}`)
      return { effect, box, cost, el: node("label", { class: "switch" }, box, node("span", {}, node("b", {}, effect.words), cost)) }
    })
    const costs = node("button", { type: "button", onclick: () => {
      costs.disabled = true
      costs.textContent = "Measuring…"
      this.model.send({ ask: "costs", result: this.index, values: this.values })
    } }, "Measure what each costs")
    this.costs = costs
    return node("details", { open: true }, node("summary", {}, "Effects"),
      node("p", { class: "fine" }, "Switches change what is shown, not what is saved."), ...this.switches.map((x) => x.el), costs,
      this.planned = node("p", { class: "fine" }))
  }
  keep(about) {
    this.name = node("input", { type: "text", value: this.result.save_as, "aria-label": "Name of the result", spellcheck: "false", autocomplete: "off" })
    this.save = node("button", { type: "button", class: "main", disabled: true, onclick: () => {
      this.model.send({ ask: "save", result: this.index, values: this.values, name: this.name.value.trim() })
    } }, "Save as a result")
    const to = node("select", { "aria-label": "Format" }, ...about.exports.map((x) => node("option", {}, x)))
    this.send = node("button", { type: "button", disabled: true, onclick: () => {
      this.state(`exporting ${this.path} to ${to.value}`)
      this.send.disabled = true
      this.model.send({ ask: "export", result: this.index, path: this.path, to: to.value })
    } }, "Export")
    const exports = about.exports.length ? node("div", { class: "row" }, to, this.send, this.hint = node("span", { class: "fine" }, "once it is saved")) : null
    return node("div", { class: "keep" }, node("div", { class: "row" }, node("span", { class: "name" }, this.name, ".json"), this.save), exports,
      this.said)
  }
  get values() { return Object.fromEntries(this.sliders.filter((x) => x.edited).map((x) => [x.q.name, x.value])) }
  changed(moving) {
    const edited = this.sliders.some((x) => x.edited)
    this.badge.hidden = !edited
    this.save.disabled = this.all.disabled = !edited
    this.ask(moving)
  }
  ask(moving) {
    clearTimeout(this.rest)
    if (moving) this.rest = setTimeout(() => this.ask(false), REST_MS)
    if (this.busy) { this.waiting = { moving }; return } // the newest takes the place of what waits
    this.busy = true
    this.asked = performance.now()
    this.slow = setTimeout(() => this.el.toggleAttribute("data-busy", true), SLOW_MS)
    this.model.send({ ask: "frame", result: this.index, values: this.values, off: [...this.off], theta_i: this.common.theta_i, exposure: this.common.exposure, moving })
  }
  hear(message) {
    if (message.answer === "frame") {
      this.busy = false
      clearTimeout(this.slow)
      this.el.removeAttribute("data-busy")
      if (message.error) this.state(message.error, true)
      else { this.show(message); if (this.said.classList.contains("bad")) this.state("") }
      if (this.waiting) { const { moving } = this.waiting; this.waiting = null; this.ask(moving) }
    } else if (message.answer === "costs") this.priced(message)
    else if (message.answer === "save" && !message.error) {
      this.path = message.path
      this.name.value = message.name
      if (this.send) { this.send.disabled = false; this.hint.textContent = message.path.split("/").pop() }
      this.state(`Saved ${message.path}`)
    } else if (message.answer === "export") { this.send.disabled = false; if (!message.error) this.state(message.said) }
    if (message.error && message.answer !== "frame") this.state(message.error, true)
  }
  show(message) {
    for (const light of LIGHTS) {
      this.images[`fit ${light}`].src = message.pictures[light]
      if (message.file) this.images[`file ${light}`].src = message.file[light]
      const apart = this.images[`apart ${light}`]
      if (apart && message.apart) apart.textContent = `ΔE ${message.apart[light].toFixed(1)}`
      if (apart) apart.classList.toggle("old", !message.apart)
    }
    if (message.moving && this.lobes.lobe) this.pace.textContent = `${(performance.now() - this.asked).toFixed(0)} ms a frame` // the first one waits for programs
    this.lobes.show(message.lobe, message.moving)
    this.shade.hidden = !message.lobe.low && !message.moving
    this.el.dataset.frame = message.moving ? "coarse" : "fine"
  }
  priced(message) {
    this.costs.disabled = false
    this.costs.textContent = "Measure again"
    if (message.error) return
    const left = []
    for (const { effect, cost } of this.switches) {
      const found = message.costs[effect.name]
      if (!found) continue
      if (!found.kept) left.push(effect.words)
      const saves = found.saves > 0.02 ? `${Math.round(100 * found.saves)} % of the time` : "takes no time"
      cost.textContent = [saves, `seen by up to ${digits(found.off_by, 2)} ΔE`, ...(effect.instead === "none" ? [] : [`off: ${effect.instead}`])].join(" · ")
    }
    this.planned.textContent = left.length ? `Left out while something moves, as no pixel showed it at the values then: ${left.join(", ")}.` : "All are kept while something moves: each is seen."
  }
  state(words, bad = false) { this.said.textContent = words; this.said.classList.toggle("bad", bad) }
}

/** What all panels share: the light's angle, scale and exposure. */
function controls(common, panels) {
  const pace = (moving) => panels.forEach((panel) => panel.ask(moving))
  const number = node("output", { "aria-live": "off" }), stops = node("output", { "aria-live": "off" })
  const theta = node("input", { type: "range", min: 0, max: common.steepest, step: 0.5, "aria-label": "theta_i, the angle of the light (degrees)", oninput: () => common.turn(Number(theta.value)), onchange: () => pace(false) })
  common.turn = (value) => {
    common.theta_i = Math.round(2 * Math.min(common.steepest, Math.max(0, value))) / 2
    theta.value = common.theta_i
    number.textContent = `${common.theta_i}°`
    pace(true)
  }
  const exposure = node("input", { type: "range", min: -4, max: 6, step: 0.25, "aria-label": "Exposure of the spheres (stops)", oninput: () => {
    common.exposure = Number(exposure.value)
    stops.textContent = `${common.exposure > 0 ? "+" : ""}${common.exposure} EV`
    pace(true)
  }, ondblclick: () => { exposure.value = 0; exposure.dispatchEvent(new Event("input")) } })
  theta.value = common.theta_i; number.textContent = `${common.theta_i}°`; exposure.value = 0; stops.textContent = "0 EV"
  const group = `merlfit-scale-${++made}`
  const scales = Object.keys(SCALES).map((scale) => node("label", {}, node("input", { type: "radio", name: group, value: scale, checked: scale === common.scale, onchange: () => {
    common.scale = scale
    panels.forEach((panel) => { panel.lobes.moving = false; panel.lobes.draw() })
  } }), node("span", {}, scale)))
  return node("div", { class: "controls", role: "group", "aria-label": "What is looked at" },
    node("label", {}, node("span", {}, "light at θ", node("sub", {}, "i")), theta, number), node("fieldset", { class: "scales" }, node("legend", {}, "scale of the lobes"), ...scales),
    node("label", {}, node("span", {}, "exposure"), exposure, stops))
}

function render({ model, el }) {
  const about = model.get("about")
  const common = { theta_i: 45, exposure: 0, scale: "cube root", steepest: about.steepest, turn: () => {} }
  const panels = about.results.map((result, k) => new Panel(result, k, about, common, model))
  const root = node("div", { class: "merlfit-view", "data-lm-suppress-shortcuts": "true" }, // of a notebook: its keys are those of the sliders
     controls(common, panels), node("div", { class: "panels" }, ...panels.map((panel) => panel.el)))
  el.append(root)
  model.on("msg:custom", (message) => panels[message.result]?.hear(message))
  panels.forEach((panel) => panel.ask(true)) // the fine ones follow when that rests
}

export default { render }
