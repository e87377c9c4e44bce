"""Reports: data (what is in one), document (the page), plots and svg (drawings), views and diagnosis (what is left), markup (HTML)."""
