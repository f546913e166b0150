//! Sheets to print, as PDF: the grid target and the chessboard, drawn in millimetres, with a ruler that shows whether the printer kept the
//! scale.

use pdf_writer::{Content, Finish, Name, Pdf, Rect, Ref, Str};

/// What the ruler on every sheet must measure, mm. Convention: as long as common rulers show well, and shorter than any paper.
pub const RULER_MM: f64 = 100.0;
/// A PDF's unit, points a millimetre. Source: ISO 32000-1, 8.3.2.3 (72 to an inch).
const POINTS_PER_MM: f64 = 72.0 / 25.4;
/// Border that is left white, mm. Convention: what common printers cannot reach, and some more.
const MARGIN_MM: f64 = 10.0;
/// Room below the target for ruler and text, mm. Convention: a display choice.
const FOOT_MM: f64 = 14.0;
/// Height of the text, mm. Convention: a display choice.
const TEXT_MM: f64 = 3.2;
/// Widths of the grid's lines, mm: the thin ones, every fifth and every tenth.
///
/// Convention: a few dots of a common printer (600 to the inch), and heavier ones twice and three times that.
const LINES_MM: [f64; 3] = [0.1, 0.2, 0.3];
/// Grey of the grid's lines, 0 black to 1 white. Convention: clearly lighter than a dark snake, clearly darker than the sheet.
const LINE_GREY: f32 = 0.55;

/// The paper.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "commands", derive(clap::ValueEnum))]
pub enum Paper {
    /// 210 mm × 297 mm
    A4,
    /// 8.5 in × 11 in
    Letter,
}

impl Paper {
    /// Width and height upright, mm. Source: ISO 216; ANSI/ASME Y14.1.
    fn size_mm(self) -> (f64, f64) {
        match self {
            Self::A4 => (210.0, 297.0),
            Self::Letter => (215.9, 279.4),
        }
    }
}

/// A sheet of graph paper.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GridTarget {
    /// Distance between neighbouring thin lines, mm.
    pub pitch_mm: f64,
}

/// A chessboard.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Chessboard {
    /// Inner corners along a row, along a column.
    pub corners: (usize, usize),
    /// Side of a square, mm.
    pub square_mm: f64,
}

/// The grid target on an upright sheet, as large as it takes.
///
/// # Errors
/// A pitch that no printer can print, or that does not fit ten times on the paper; in words.
pub fn grid_pdf(paper: Paper, grid: &GridTarget) -> Result<Vec<u8>, String> {
    let (width_mm, height_mm) = paper.size_mm();
    let pitch_mm = grid.pitch_mm;
    let room = (width_mm - 2.0 * MARGIN_MM, height_mm - 2.0 * MARGIN_MM - FOOT_MM);
    let most_mm = room.0 / 10.0;
    if !(0.5..=most_mm).contains(&pitch_mm) {
        return Err(format!(
            "lines {pitch_mm} mm apart: expected 0.5 to {most_mm:.1} mm, so that they can be told apart and ten fit the paper"
        ));
    }
    // Whole fields of ten, so that the heavier lines frame the grid.
    let fields = |room_mm: f64| (room_mm / (10.0 * pitch_mm)) as usize * 10;
    let (columns, rows) = (fields(room.0), fields(room.1));
    let (left, bottom) = ((width_mm - columns as f64 * pitch_mm) / 2.0, MARGIN_MM + FOOT_MM);
    let (right, top) = (left + columns as f64 * pitch_mm, bottom + rows as f64 * pitch_mm);
    let mut content = in_millimetres();
    content.set_stroke_gray(LINE_GREY);
    // Heavier lines last, so that they run through.
    for (heaviness, width) in LINES_MM.into_iter().enumerate() {
        content.set_line_width(width as f32);
        let drawn = |k: &usize| heaviness == usize::from(k.is_multiple_of(5)) + usize::from(k.is_multiple_of(10));
        for x in (0..=columns).filter(drawn).map(|k| left + k as f64 * pitch_mm) {
            line(&mut content, (x, bottom), (x, top));
        }
        for y in (0..=rows).filter(drawn).map(|k| bottom + k as f64 * pitch_mm) {
            line(&mut content, (left, y), (right, y));
        }
    }
    let title = format!("snakeloop grid target: a thin line every {pitch_mm} mm");
    foot(&mut content, left, &title);
    Ok(document((width_mm, height_mm), content))
}

/// The chessboard, on a sheet that lies or stands as it fits.
///
/// # Errors
/// Fewer than three corners either way, or a board that does not fit the paper; in words.
pub fn chessboard_pdf(paper: Paper, board: &Chessboard) -> Result<Vec<u8>, String> {
    let (columns, rows) = (board.corners.0 + 1, board.corners.1 + 1);
    let square_mm = board.square_mm;
    let (short_mm, long_mm) = paper.size_mm();
    let (wide_mm, high_mm) = (columns as f64 * square_mm, rows as f64 * square_mm);
    let fits = |(width_mm, height_mm): &(f64, f64)| {
        wide_mm <= width_mm - 2.0 * MARGIN_MM && high_mm <= height_mm - 2.0 * MARGIN_MM - FOOT_MM
    };
    if columns < 4 || rows < 4 || square_mm.is_nan() || square_mm < 1.0 {
        return Err("expected at least 3x3 corners and squares of 1 mm or more".to_owned());
    }
    let Some(size_mm) = [(long_mm, short_mm), (short_mm, long_mm)].into_iter().find(fits) else {
        return Err(format!("{columns}×{rows} squares of {square_mm} mm do not fit the paper; make them smaller"));
    };
    let (left, bottom) = ((size_mm.0 - wide_mm) / 2.0, MARGIN_MM + FOOT_MM);
    let mut content = in_millimetres();
    content.set_fill_gray(0.0);
    for (row, column) in (0..rows).flat_map(|row| (0..columns).map(move |column| (row, column))) {
        if (row + column) % 2 == 0 {
            let (x, y) = (left + column as f64 * square_mm, bottom + row as f64 * square_mm);
            content.rect(x as f32, y as f32, square_mm as f32, square_mm as f32);
        }
    }
    content.fill_nonzero();
    let (inner_columns, inner_rows) = board.corners;
    let title = format!("snakeloop calibrate camera --corners {inner_columns}x{inner_rows} --square {square_mm}");
    foot(&mut content, left, &title);
    Ok(document(size_mm, content))
}

/// A page's content whose lengths are millimetres from the lower left corner.
fn in_millimetres() -> Content {
    let mut content = Content::new();
    let scale = POINTS_PER_MM as f32;
    content.transform([scale, 0.0, 0.0, scale, 0.0, 0.0]);
    content
}

fn line(content: &mut Content, from: (f64, f64), to: (f64, f64)) {
    content.move_to(from.0 as f32, from.1 as f32);
    content.line_to(to.0 as f32, to.1 as f32);
    content.stroke();
}

/// The ruler, what the sheet is, and how to print it.
fn foot(content: &mut Content, left: f64, title: &str) {
    let base = MARGIN_MM;
    content.set_stroke_gray(0.0).set_fill_gray(0.0).set_line_width(0.2);
    line(content, (left, base), (left + RULER_MM, base));
    for mm in 0..=RULER_MM as usize {
        let height = if mm.is_multiple_of(10) {
            3.0
        } else if mm.is_multiple_of(5) {
            2.0
        } else {
            1.0
        };
        let x = left + mm as f64;
        line(content, (x, base), (x, base + height));
    }
    let how = format!("Print at 100 % (actual size): this ruler must be {RULER_MM} mm long.");
    for (text, x, y) in [(title, left, base + 8.5), (&how, left, base + 4.5)] {
        content.begin_text().set_font(Name(b"F"), TEXT_MM as f32).next_line(x as f32, y as f32);
        content.show(Str(text.as_bytes())).end_text();
    }
}

/// A document of one page.
fn document(size_mm: (f64, f64), content: Content) -> Vec<u8> {
    let [catalog, pages, page, text, font] = [1, 2, 3, 4, 5].map(Ref::new);
    let mut pdf = Pdf::new();
    let mut root = pdf.catalog(catalog);
    root.pages(pages);
    // Printing dialogues then offer the true size first.
    root.insert(Name(b"ViewerPreferences")).dict().pair(Name(b"PrintScaling"), Name(b"None"));
    root.finish();
    pdf.pages(pages).kids([page]).count(1);
    let mut sheet = pdf.page(page);
    let points = |mm: f64| (mm * POINTS_PER_MM) as f32;
    sheet.media_box(Rect::new(0.0, 0.0, points(size_mm.0), points(size_mm.1))).parent(pages).contents(text);
    sheet.resources().fonts().pair(Name(b"F"), font);
    sheet.finish();
    pdf.type1_font(font).base_font(Name(b"Helvetica"));
    pdf.stream(text, &content.finish());
    pdf.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The numbers before each operator of this name in a sheet's content.
    fn operands<const N: usize>(pdf: &[u8], operator: &str) -> Vec<[f64; N]> {
        let text = String::from_utf8_lossy(pdf).into_owned();
        let line = |line: &str| {
            let numbers = line.strip_suffix(operator)?.split_whitespace().map(str::parse);
            numbers.collect::<Result<Vec<f64>, _>>().ok()?.try_into().ok()
        };
        text.lines().filter_map(line).collect()
    }

    #[test]
    fn the_grid_is_to_scale_and_the_ruler_is_a_hundred_millimetres() {
        let pdf = grid_pdf(Paper::A4, &GridTarget { pitch_mm: 1.0 }).unwrap();
        let [scale] = operands::<6>(&pdf, " cm")[..] else { panic!("one transformation") };
        assert!((scale[0] - 72.0 / 25.4).abs() < 1e-5 && scale[0] == scale[3]);
        let starts = operands::<2>(&pdf, " m");
        let ends = operands::<2>(&pdf, " l");
        let mut upright: Vec<f64> =
            starts.iter().zip(&ends).filter(|(a, b)| a[0] == b[0] && b[1] - a[1] > 50.0).map(|(a, _)| a[0]).collect();
        upright.sort_by(f64::total_cmp);
        assert_eq!(upright.len(), 191, "190 mm of lines");
        assert!(upright.windows(2).all(|pair| (pair[1] - pair[0] - 1.0).abs() < 1e-4));
        let ruler = starts.iter().zip(&ends).find(|(a, _)| a[1] == MARGIN_MM && a[0] == upright[0]).unwrap();
        assert_eq!(ruler.1[0] - ruler.0[0], RULER_MM);
        let text = String::from_utf8_lossy(&pdf).into_owned();
        assert!(text.contains("MediaBox [0 0 595.2756 841.8898]") && text.contains("/PrintScaling /None"));
    }

    #[test]
    fn the_board_has_its_squares_and_lies_where_it_must() {
        for paper in [Paper::A4, Paper::Letter] {
            let pdf = chessboard_pdf(paper, &Chessboard { corners: (9, 6), square_mm: 25.0 }).unwrap();
            let squares = operands::<4>(&pdf, " re");
            assert_eq!(squares.len(), 35, "half of 10×7");
            let (long_mm, short_mm) = (paper.size_mm().1, paper.size_mm().0);
            assert!(
                squares.iter().all(|s| s[2] == 25.0 && s[0] > 5.0 && s[0] + 25.0 < long_mm && s[1] + 25.0 < short_mm)
            );
        }
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        let big = Chessboard { corners: (9, 6), square_mm: 30.0 };
        assert!(chessboard_pdf(Paper::A4, &big).unwrap_err().contains("make them smaller"));
        for pitch_mm in [0.1, 30.0, f64::NAN] {
            assert!(grid_pdf(Paper::Letter, &GridTarget { pitch_mm }).is_err());
        }
    }
}
