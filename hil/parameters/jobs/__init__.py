"""Parts of the parameters' job."""
