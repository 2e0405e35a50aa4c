// Browsers allow no worker to a page that was opened as a file. There, the script of a worker runs in a hidden frame,
// so that the site can be searched without a server. MkDocs' plugin `offline` looks for a file of this name.
"use strict";
if (location.protocol === "file:") {
    class FrameWorker extends EventTarget {
        constructor(source) {
            super();
            this.frame = document.createElement("iframe");
            this.frame.hidden = true;
            document.body.appendChild(this.frame);
            const inside = this.frame.contentWindow;
            inside.postMessage = (data) => this.dispatchEvent(new MessageEvent("message", { data }));
            this.ready = new Promise((resolve, reject) => {
                const script = inside.document.createElement("script");
                Object.assign(script, { src: source, onload: resolve, onerror: reject });
                inside.document.body.appendChild(script);
            });
        }

        postMessage(data) {
            const inside = this.frame.contentWindow;
            this.ready.then(() => inside.dispatchEvent(new inside.MessageEvent("message", { data })));
        }

        terminate() {
            this.frame.remove();
        }
    }
    window.Worker = window.IFrameWorker = FrameWorker;
}
