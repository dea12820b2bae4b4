"""What is compared: one file or folder a method, and the table that names them."""
