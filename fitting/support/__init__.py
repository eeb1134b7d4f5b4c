"""What every other part uses: threads, clocks, compiled programs and tables on disk, the terminal."""
