"""Tables as text: Markdown, CSV, LaTeX, HTML, and on the console."""
