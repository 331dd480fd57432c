"""The report as one page: plain data, and a static page that shows it (docs/report.md)."""
