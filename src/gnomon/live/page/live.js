"use strict"; // what all pages of a guided capture share
const $ = (id) => document.getElementById(id);
const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
const counted = (count, what) => `${count} ${what}${count === 1 ? "" : "s"}`;
let shown = "", audio = null;

function beep(pitch) {
  if (!$("sound").checked) return;
  audio = audio || new AudioContext();
  const tone = audio.createOscillator(), gain = audio.createGain();
  tone.frequency.value = pitch;
  gain.gain.setValueAtTime(0.2, audio.currentTime);
  gain.gain.exponentialRampToValueAtTime(0.001, audio.currentTime + 0.2);
  tone.connect(gain).connect(audio.destination);
  tone.start();
  tone.stop(audio.currentTime + 0.2);
}

function speak(text) {
  if (!$("speech").checked || !window.speechSynthesis) return;
  speechSynthesis.cancel();
  speechSynthesis.speak(Object.assign(new SpeechSynthesisUtterance(text), { lang: "en" }));
}

// where another device in the network goes, as a code for its camera
function showPhone(address) {
  if (!address || !$("phone").hidden) return;
  $("phone").hidden = false;
  $("address").textContent = address;
  $("code").src = "code.svg";
}

// what is said, and how it ended; the words on the numbers come from the page
function showCommon(next, numbers) {
  showPhone(next.phone);
  const advice = next.stopped ? "Calibrating." : next.advice;
  if (advice !== shown) {
    const alike = advice.replace(/\d+/g, "") === shown.replace(/\d+/g, "");
    $("advice").setAttribute("aria-live", alike ? "off" : "polite"); // numbers count down, and not each second aloud
    $("advice").textContent = shown = advice;
    if (!alike) speak(advice);
  }
  $("advice").className = next.confirmed ? "enough" : "";
  $("stop").className = next.confirmed ? "enough" : "";
  $("numbers").textContent = `${next.seconds.toFixed(0)} s, ${next.rate_hz.toFixed(0)} Hz${numbers && `, ${numbers}`}` +
    (next.damaged ? `, ${next.damaged} damaged lines` : "");
  const faults = next.stopped ? [] : next.faults.map(([, text]) => text); // what is over is not mended
  if ($("faults").dataset.shown !== faults.join("\n")) {
    $("faults").dataset.shown = faults.join("\n");
    $("faults").replaceChildren(...faults.map((text) => Object.assign(document.createElement("li"), { textContent: text })));
  }
}

function showResult(result) {
  $("advice").setAttribute("aria-live", "polite");
  $("advice").textContent = result === "done" ? "Done. Here is the report." :
    "The recording is kept, but it gave no calibration: the terminal says why.";
  $("report").hidden = result !== "done";
  $("stop").hidden = true;
  if (result === "done") location.href = "report";
}

// show each state as it comes, and return where the events come from
function follow(show) {
  const events = new EventSource("events");
  events.addEventListener("state", (event) => {
    const next = JSON.parse(event.data);
    if (!next.result) { showCommon(next, show(next)); return; }
    events.close();
    showResult(next.result);
  });
  events.onerror = () => { if (!$("stop").hidden) $("numbers").textContent = "the connection is lost"; };
  $("stop").addEventListener("click", async () => {
    $("stop").disabled = true;
    await fetch("stop", { method: "POST" });
  });
  history.replaceState(null, "", location.pathname); // the token is in a cookie now
  const stayAwake = () => navigator.wakeLock?.request("screen").catch(() => {}); // where it may: here, or over TLS
  document.addEventListener("visibilitychange", () => { if (!document.hidden) stayAwake(); });
  stayAwake();
  return events;
}
