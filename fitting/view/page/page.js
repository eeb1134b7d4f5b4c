// The page's model: what a notebook's widget has of its kernel, over a websocket.
import view from "./view.js"

const el = document.getElementById("view")
const socket = new WebSocket(new URL("live", location.href.replace(/^http/, "ws")))
const heard = []
let about = null

const model = {
  get: (name) => (name === "about" ? about : undefined),
  send: (message) => { if (socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message)) },
  on: (event, call) => { if (event === "msg:custom") heard.push(call) },
}

socket.addEventListener("message", (event) => {
  const message = JSON.parse(event.data)
  if (message.about) {
    about = message.about
    document.title = `${about.results.map((r) => r.name).join(", ")} - merlfit view`
    el.replaceChildren()
    view.render({ model, el })
  } else heard.forEach((call) => call(message))
})
socket.addEventListener("close", () => {
  const gone = document.createElement("p")
  gone.className = "merlfit-gone"
  gone.setAttribute("role", "alert")
  gone.textContent = "merlfit view has ended: start it again in the terminal, and open the new address."
  el.prepend(gone)
})
