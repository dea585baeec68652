// A page that is opened from the disk starts no worker. There the site's search runs in a hidden frame instead, which
// answers as a worker does. The file's name keeps the theme from loading another one from the network.
"use strict";
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(url) {
      super();
      const frame = document.createElement("iframe");
      frame.hidden = true;
      frame.srcdoc = `<script>postMessage = data => frameElement.answer(data)</script><script src="${url}"></script>`;
      frame.answer = data => this.dispatchEvent(new MessageEvent("message", { data }));
      this.loaded = new Promise(done => frame.addEventListener("load", () => done(frame.contentWindow)));
      document.documentElement.append(frame);
    }

    postMessage(data) {
      this.loaded.then(inside => inside.dispatchEvent(new MessageEvent("message", { data })));
    }
  };
}
