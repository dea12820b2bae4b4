"""What a report lets its reader look at: pictures, maps, and the numbers of single pixels."""
