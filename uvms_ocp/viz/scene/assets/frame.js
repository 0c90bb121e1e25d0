// Gives a frame of a notebook's page the viewer that another one brought, as soon as there are both.
((name) => {
  const MARK = "<!--viewer-->", began = Date.now(), viewers = (window.uvmsOcpViewers ??= {}); // outlive the cells that brought them
  const draw = () => {
    const frame = document.getElementById(name), digest = frame?.dataset.viewer;
    const others = [...document.querySelectorAll("iframe[srcdoc]")].filter(({dataset}) => dataset.viewer === digest);
    viewers[digest] ??= others.map(({srcdoc}) => srcdoc.split(MARK)[1]).find(Boolean);
    if (frame && viewers[digest]) {
      frame.srcdoc = frame.dataset.page.replace(MARK, () => MARK + viewers[digest] + MARK);
      return;
    }
    if (frame && !frame.srcdoc && Date.now() - began > 2000)
      frame.srcdoc = "<p style='font-family: sans-serif; color: #888'>The viewer of this page's scenes came with another cell, " +
        "which has been cleared or is not there yet. Run this cell again, and the viewer comes with it.</p>";
    setTimeout(draw, 300);
  };
  setTimeout(draw);
})