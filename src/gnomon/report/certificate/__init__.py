"""Page one of a report: what a laboratory hands on; on the page and as a PDF."""
