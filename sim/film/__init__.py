"""Films of simulated runs, drawn by matplotlib and encoded by ffmpeg."""
