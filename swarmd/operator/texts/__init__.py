"""What people write and read: values in short, assignments, and a status in words."""
