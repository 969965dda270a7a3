// Names for the buttons that open parts of the sidebar, for screen readers.
document.addEventListener("DOMContentLoaded", () => {
    for (const summary of document.querySelectorAll("nav details > summary")) {
        const link = summary.closest("li")?.querySelector("a");
        summary.setAttribute("aria-label", `Show pages of ${link?.textContent.trim() ?? "this part"}`);
    }
});
