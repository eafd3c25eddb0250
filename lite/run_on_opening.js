// A JupyterLab extension without a build: runs the notebook of an address that ends with "&run=1".
(window._JUPYTERLAB ??= {})["esfem-run"] = {
  init: async () => {},
  get: async () => () => ({
    id: "esfem-run:run-on-opening",
    autoStart: true,
    activate: (app) => {
      if (new URLSearchParams(location.search).get("run") !== "1") return;
      app.restored.then(async () => {
        while (!app.shell.currentWidget?.sessionContext) {
          await new Promise((resolve) => setTimeout(resolve, 100));
        }
        const notebook = app.shell.currentWidget;
        await notebook.context.ready;
        await notebook.sessionContext.ready;
        await app.commands.execute("notebook:run-all-cells");
      });
    },
  }),
};
