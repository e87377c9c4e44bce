for (const button of document.querySelectorAll("button[data-csv]")) {
  button.hidden = false;
  button.addEventListener("click", () => {
    const columns = JSON.parse(document.getElementById(button.dataset.csv).textContent).columns;
    const names = Object.keys(columns);
    const lines = columns[names[0]].map((_, row) => names.map((name) => columns[name][row] ?? "").join(","));
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([[names.join(","), ...lines, ""].join("\n")], { type: "text/csv" }));
    link.download = button.dataset.csv.replace(/^data-/, "") + ".csv";
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  });
}
