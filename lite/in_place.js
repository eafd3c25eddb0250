// The front page's cell, which runs where it stands: a slider for alpha, a worker that computes.
// Called with the ids of its place and of the still picture, two addresses and a size.
(function (id, stillId, plotly, worker, megabytes) {
  "use strict";
  const [place, still] = [id, stillId].map((name) => document.getElementById(name));
  if (location.protocol === "file:") return; // no server, no worker: the picture stays
  place.innerHTML = `<p>
    <button type="button" class="btn btn-sm btn-outline-primary">Run it here (${megabytes} MB)</button>
    <label hidden>α <input type="range" min="-2" max="0.5" step="0.1" value="-1.5"></label>
    <output></output></p><div></div>`;
  const [button, label, slider, says, stage] = ["button", "label", "input", "output", "div"].map(
    (part) => place.querySelector(part),
  );
  const alpha = () => Number((10 ** slider.value).toPrecision(2));
  let python;
  let busy = true;

  function ask() {
    if (busy) return;
    busy = true;
    python.postMessage(alpha());
  }

  function draw({ x, y, z, u, i, j, k, asked, seconds }) {
    const axis = { visible: false, range: [-1.6, 1.6] };
    const view = { eye: { x: 0.9, y: 0.9, z: 0.6 } };
    Plotly.react(
      stage,
      [{ type: "mesh3d", x, y, z, i, j, k, intensity: u, colorscale: "Viridis", cmin: 0, cmax: 1 }],
      {
        height: 450, margin: { l: 0, r: 0, t: 0, b: 0 }, uirevision: "keep",
        paper_bgcolor: "rgba(0,0,0,0)",
        scene: { aspectmode: "cube", xaxis: axis, yaxis: axis, zaxis: axis, camera: view },
      },
      { responsive: true, displayModeBar: false },
    );
    says.textContent = `α = ${asked}: ${x.length} nodes, 20 steps in ${seconds.toFixed(2)} s`;
    if (still) still.hidden = true;
    busy = false;
    if (alpha() !== asked) ask(); // the slider has moved meanwhile
  }

  function fail(reason) {
    says.textContent = `It does not run here: ${reason}`;
    if (still) still.hidden = false;
  }

  function load(address) {
    return new Promise((done, failed) => {
      if (window.Plotly) return done();
      const script = Object.assign(document.createElement("script"), { src: address });
      script.onload = done;
      script.onerror = () => failed(new Error(address));
      document.head.append(script);
    });
  }

  button.addEventListener("click", async () => {
    button.hidden = true;
    says.textContent = "Loading Python …";
    python = new Worker(worker, { type: "module" });
    python.onerror = (event) => fail(event.message || "the worker did not start");
    python.onmessage = ({ data }) => {
      if (data.error) return fail(data.error);
      if (data.x) return draw(data);
      label.hidden = busy = false;
      ask();
    };
    await load(plotly).catch(fail);
  });
  slider.addEventListener("input", ask);
})
