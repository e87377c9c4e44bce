"""Reports: `data` (contents), `document` (the page), `plots` and `svg` (drawings), `views` (residuals), `markup` (HTML)."""
