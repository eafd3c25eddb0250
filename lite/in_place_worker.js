// Loads Python and the cells of the front page that run there, and computes what is asked for.
const kernel = "@jupyterlite/pyodide-kernel-extension:kernel";
const here = (address) => new URL(address, self.location).href;

async function start() {
  const site = await (await fetch(here("jupyter-lite.json"))).json();
  const settings = site["jupyter-config-data"].litePluginSettings[kernel];
  const { loadPyodide } = await import(here(settings.pyodideUrl));
  const lockFileURL = here(settings.loadPyodideOptions.lockFileURL);
  const python = await loadPyodide({ lockFileURL, packages: ["esfem-core"] });
  await python.runPythonAsync(await (await fetch(here("in_place.py"))).text());
  await python.runPythonAsync(`
import json, time
from esfem_core.elements import flat_triangles

def shown(alpha):
    start = time.perf_counter()
    state = grown(alpha)
    seconds = time.perf_counter() - start
    triangles = flat_triangles(state.space.cells, state.space.degree)
    numbers = zip("xyzuijk", (*state.x.T, state.u, *triangles.T))
    return json.dumps({name: n.tolist() for name, n in numbers} | {"asked": alpha, "seconds": seconds})
`);
  return python.globals.get("shown");
}

const started = start();
started.then(() => self.postMessage({}), (error) => self.postMessage({ error: String(error) }));
self.onmessage = async ({ data }) => {
  try {
    self.postMessage(JSON.parse((await started)(data)));
  } catch (error) {
    self.postMessage({ error: String(error) });
  }
};
