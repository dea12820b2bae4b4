"""What a page shows, one file for each kind of block; `novags.testbed.report.page.BLOCKS` lists them."""
