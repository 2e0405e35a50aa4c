"use strict";
// Measures beside the page, so that the mechanism goes on moving.
importScripts("kernels.js", "front.js");
self.onmessage = async ({ data: { machine, methods } }) => {
  try {
    self.postMessage(await measureFront(machine, methods));
  } catch (error) {
    self.postMessage({ failure: String(error.message || error) });
  }
};
