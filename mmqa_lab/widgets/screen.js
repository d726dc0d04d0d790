// Names sliders, canvases and pictures of a notebook for screen readers, now and as they come, and
// lets the arrow keys move within a list: JupyterLab would move to the next cell.
(() => {
  if (window.mmqaNames) return;
  const name = () => {
    for (const handle of document.querySelectorAll(".noUi-handle:not([aria-label])")) {
      const label = handle.closest(".jupyter-widgets")?.querySelector(".widget-label");
      handle.setAttribute("aria-label", label?.textContent || "value");
    }
    for (const list of document.querySelectorAll(".jupyter-widgets select")) {
      list.setAttribute("data-lm-suppress-shortcuts", "true");
    }
    for (const frame of document.querySelectorAll("iframe.pyvista:not([title])")) {
      frame.title = "View in space";
    }
    for (const canvas of document.querySelectorAll(".jupyter-matplotlib-canvas-div:not([role])")) {
      canvas.setAttribute("role", "img");
      canvas.setAttribute("aria-label", "Picture of points. Its figures are the text below it.");
    }
    for (const picture of document.querySelectorAll(".jp-OutputArea img:not([alt])")) {
      const headings = [...document.querySelectorAll(".jp-RenderedMarkdown :is(h1, h2, h3)")];
      const after = Node.DOCUMENT_POSITION_FOLLOWING;
      const above = headings.filter((one) => one.compareDocumentPosition(picture) & after).pop();
      picture.alt = `Figure, ${above?.firstChild.textContent ?? "see the cell above"}`;
    }
  };
  window.mmqaNames = new MutationObserver(name);
  window.mmqaNames.observe(document.body, { childList: true, subtree: true });
  name();
})();
